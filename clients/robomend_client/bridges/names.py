"""The model's names and ROS's: `scan` is /scan, or /robot1/scan in the namespace /robot1."""

from __future__ import annotations

from collections.abc import Mapping


class Names:
    """Both ways."""

    def __init__(self, namespace: str = "", others: Mapping[str, str] | None = None) -> None:
        """`others` are names of the model that ROS calls something else altogether."""
        self._namespace = "/" + namespace.strip("/") + "/" if namespace.strip("/") else "/"
        self._ros = {ours: resolved(ros) for ours, ros in (others or {}).items()}
        self._ours = {ros: ours for ours, ros in self._ros.items()}

    def ros(self, name: str) -> str:
        """Return what ROS calls it."""
        return self._ros.get(name) or self._namespace + name.strip("/")

    def ours(self, name: str) -> str:
        """Return what the model calls it."""
        return self._ours.get(name) or name.removeprefix(self._namespace).strip("/")


def resolved(name: str) -> str:
    return "/" + name.strip("/")
