"""Who carries out the actions of a plan, all by one signature: robomend_client.actions.Executor.

registry.py has them by kind, and says how to add one.
"""
