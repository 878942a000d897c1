"""A robot with ROS 2 over zenoh for tests: a router, and nodes that speak as rmw_zenoh does.

There is no wheel of rmw_zenoh. zenoh_node.py writes keys and attachments by its documented format with the
wheel of zenoh itself.
The router and its nodes meet at a socket in a file, so that no port is taken from anybody.
"""

from __future__ import annotations

import json
import os
import shutil
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import zenoh
from tests.node_process import NodeProcess

NODE = Path(__file__).parent / "zenoh_node.py"

ROUTER = """
import json, sys, zenoh
listen, connect = sys.argv[1:3]
config = zenoh.Config()
config.insert_json5("mode", '"router"')
config.insert_json5("scouting/multicast/enabled", "false")
config.insert_json5("listen/endpoints", json.dumps([listen]))
config.insert_json5("connect/endpoints", json.dumps([connect] if connect else []))
config.insert_json5("transport/link/tx/lease", "2000")
config.insert_json5("adminspace/enabled", "true")
with zenoh.open(config):
    for line in sys.stdin:
        print('{"answer": null}', flush=True)
"""
"""In a process of its own. Whoever does not hear it takes it for lost after 2 s, not after 10."""


def open_session(mode: str, **endpoints: str) -> Any:
    """Open a session that looks nowhere but where it is told to."""
    config = zenoh.Config()
    config.insert_json5("mode", json.dumps(mode))
    config.insert_json5("scouting/multicast/enabled", "false")
    for side in ("listen", "connect"):
        config.insert_json5(f"{side}/endpoints", json.dumps([endpoints[side]] if side in endpoints else []))
    return zenoh.open(config)


class ZenohRobot:
    """Nodes around one router, which all end with the test."""

    def __init__(self, folder: Path, sockets: Path) -> None:
        self.folder = folder
        self.domain = 0
        self.endpoint = f"unixsock-stream/{sockets}/router"
        self.nodes: dict[str, NodeProcess] = {}
        self.router: Any = None
        self.start_router()

    def start_router(self) -> None:
        self.router = open_session("router", listen=self.endpoint)

    def stop_router(self) -> None:
        if self.router is not None:
            self.router.close()
            self.router = None

    def node(self, name: str, *arguments: str) -> NodeProcess:
        """Start a node and wait until it is up."""
        command = [sys.executable, str(NODE), self.endpoint, *arguments]
        node = self.nodes[name] = NodeProcess(name, command, os.environ, self.folder)
        node.do("nothing")
        return node

    def close(self) -> None:
        for node in self.nodes.values():
            node.close()
        self.stop_router()


@contextmanager
def robot(folder: Path) -> Iterator[ZenohRobot]:
    """A robot whose nodes are yet to be started."""
    sockets = Path(tempfile.mkdtemp(prefix="zenoh-"))
    found = ZenohRobot(folder, sockets)
    try:
        yield found
    finally:
        found.close()
        shutil.rmtree(sockets)
