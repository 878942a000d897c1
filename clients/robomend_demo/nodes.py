"""The robot's nodes, simulated: one generic node process.

    python -m robomend_demo.nodes --name jaguar_node --config FILE

    device ──readings──► driver ──odom──► bus ──► other nodes that need it
                                          └────► the agent's observers

A driver connects to its devices once, when it starts, and publishes each of its topics for every reading of
the first. When a device's power goes, the connection ends: the driver goes on running, mute, until it is
restarted, as in the paper. Any other node publishes a topic whenever its first input arrives, if the other
inputs are no older than STALE_S; one without inputs publishes at rate_hz.

The file is JSON (cast.py writes it): {"startup_s": 0.2, "rate_hz": 10, "devices": {"jaguar":
"127.0.0.1:40123"}, "nodes": {"jaguar_node": {"drives": ["jaguar"], "publishes": {"odom": []}}}}. `startup_s`
counts from the start of the process, so the interpreter's own time is in it. Then the node says READY=1
(sd_notify) to whoever started it.

This file imports little and no asyncio: the interpreter and it are up in about 40 ms.
"""

from __future__ import annotations

import json
import os
import selectors
import socket
import sys
import time

from robomend_client.bus import ENVIRONMENT, Bus, BusGone

TYPE_CHECKING = False  # typing's own would cost its import
if TYPE_CHECKING:
    from collections.abc import Iterable
    from typing import Any

STALE_S = 1.0
"""An input that old does not count as there."""

NICE = 5
"""Nine interpreters that start at once must not take the processor from those who watch and repair them."""

BUS_RETRY_S = 0.5
CONNECT_S = 1.0


class Node:
    """One node; `turn` handles what has arrived."""

    def __init__(self, name: str, config: dict[str, Any], bus_address: str | None) -> None:
        own = config["nodes"][name]
        self.name = name
        self.drives: list[str] = list(own.get("drives", ()))
        self.publishes: dict[str, list[str]] = dict(own.get("publishes", {}))
        self.devices: dict[str, str] = config["devices"]
        self.period_s = 1.0 / float(config.get("rate_hz", 10.0))
        self.mute = False
        self._arrived: dict[str, float] = {}
        self._selector = selectors.DefaultSelector()
        self._bus_address = bus_address
        self._bus: Bus | None = None
        self._bus_next_s = 0.0
        self._beat_s = time.monotonic()
        self._sent = 0

    def connect(self) -> None:
        """Connect to the bus, and to the devices: that only once."""
        self._connect_bus()
        for device in self.drives:
            host, _, port = self.devices[device].rpartition(":")
            try:
                connection = socket.create_connection((host, int(port)), timeout=CONNECT_S)
            except OSError as error:
                self._lost(f"{device}: {error}")
            else:
                connection.setblocking(False)
                self._selector.register(connection, selectors.EVENT_READ, (device, bytearray()))

    def run(self) -> None:
        while True:
            self.turn()

    def turn(self) -> None:
        """Wait for something to do, and do it."""
        for key, _ in self._selector.select(self._wait_s()):
            if key.data is None:
                self._from_bus()
            else:
                self._from_device(key)
        if self._bus is None and time.monotonic() >= self._bus_next_s:
            self._connect_bus()
        if self._is_source and time.monotonic() >= self._beat_s:
            self._beat_s += self.period_s
            self._publish(topic for topic, inputs in self.publishes.items() if not inputs)

    @property
    def _is_source(self) -> bool:
        return not self.drives and any(not inputs for inputs in self.publishes.values())

    def _wait_s(self) -> float | None:
        due = [self._beat_s] if self._is_source else []
        if self._bus is None and self._bus_address:
            due.append(self._bus_next_s)
        return max(0.0, min(due) - time.monotonic()) if due else None

    # --- devices -----------------------------------------------------------------------------------

    def _from_device(self, key: selectors.SelectorKey) -> None:
        device, buffer = key.data
        connection = key.fileobj
        assert isinstance(connection, socket.socket)
        try:
            data = connection.recv(65536)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        if not data:
            self._selector.unregister(connection)
            connection.close()
            self._lost(f"{device}: the connection ended")
            return
        buffer += data
        readings = buffer.count(b"\n")
        del buffer[: buffer.rfind(b"\n") + 1]
        if device == self.drives[0] and not self.mute:
            for _ in range(readings):
                self._publish(self.publishes)

    def _lost(self, why: str) -> None:
        self.mute = True
        print(f"{self.name}: {why}; mute until restarted", flush=True)

    # --- bus ---------------------------------------------------------------------------------------

    def _connect_bus(self) -> None:
        self._bus_next_s = time.monotonic() + BUS_RETRY_S
        if not self._bus_address:
            return
        try:
            self._bus = Bus(self._bus_address)
            inputs = sorted({name for names in self.publishes.values() for name in names})
            if inputs:
                self._bus.subscribe(*inputs)
            self._selector.register(self._bus, selectors.EVENT_READ, None)
        except BusGone:
            self._bus = None

    def _from_bus(self) -> None:
        if self._bus is None:
            return
        try:
            for topic, _ in self._bus.receive():
                self._input(topic)
        except BusGone:
            self._leave_bus()

    def _input(self, topic: str) -> None:
        now_s = time.monotonic()
        self._arrived[topic] = now_s
        if self.drives:
            return
        self._publish(
            output
            for output, inputs in self.publishes.items()
            if inputs
            and inputs[0] == topic
            and all(now_s - self._arrived.get(name, -STALE_S) < STALE_S for name in inputs)
        )

    def _publish(self, topics: Iterable[str]) -> None:
        for topic in topics:
            if self._bus is None:
                return
            self._sent += 1
            try:
                self._bus.publish(topic, {"node": self.name, "seq": self._sent})
            except BusGone:
                self._leave_bus()

    def _leave_bus(self) -> None:
        if self._bus is not None:
            try:
                self._selector.unregister(self._bus)
            except (KeyError, ValueError):
                # Closed in the middle of a send: the selector forgets it by the number it had.
                self._forget_closed()
            self._bus.close()
            self._bus = None

    def _forget_closed(self) -> None:
        """Make a new selector of what is still open."""
        old, self._selector = self._selector, selectors.DefaultSelector()
        for key in list(old.get_map().values()):
            if key.data is not None:
                self._selector.register(key.fileobj, key.events, key.data)
        old.close()


def running_s() -> float:
    """Return for how long this process has run, from its start by the kernel."""
    with open("/proc/self/stat", "rb") as file:
        fields = file.read().rpartition(b")")[2].split()
    return time.clock_gettime(time.CLOCK_BOOTTIME) - int(fields[19]) / os.sysconf("SC_CLK_TCK")


def notify_ready() -> None:
    """Tell whoever started us that we are up: sd_notify(3)."""
    address = os.environ.get("NOTIFY_SOCKET")
    if address:
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as notification:
            try:
                notification.sendto(b"READY=1", "\0" + address[1:] if address[0] == "@" else address)
            except OSError as error:
                print(f"nobody hears that this node is ready: {error}", file=sys.stderr)


def main() -> int:
    os.nice(NICE)
    arguments = dict(zip(sys.argv[1::2], sys.argv[2::2], strict=False))  # argparse would cost 10 ms
    if set(arguments) != {"--name", "--config"}:
        print("usage: python -m robomend_demo.nodes --name NODE --config FILE", file=sys.stderr)
        return 2
    with open(arguments["--config"], encoding="utf-8") as file:
        config = json.load(file)
    node = Node(arguments["--name"], config, os.environ.get(ENVIRONMENT))
    time.sleep(max(0.0, float(config.get("startup_s", 0.0)) - running_s()))
    node.connect()
    notify_ready()
    node.run()
    return 0


if __name__ == "__main__":
    sys.exit(main())
