"""Bridges to what robots run already, as parts of the agent: each is a feed (agent/feeds.py) that is loaded
only when the agent's file has its section.

ros1/   ROS 1: the master's XML-RPC and TCPROS, spoken on asyncio
"""
