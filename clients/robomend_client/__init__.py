"""The robot's side of robomend: the REST client, observers and agent, and the words that both sides share.

This package needs no solver and no planner; it installs alone as the distribution `robomend-client`.
"""
