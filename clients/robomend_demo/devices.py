"""The robot's devices, simulated: a TCP port that exists only while the device has power.

    board emulator ──control port, "watch"──► power ──► port open, readings to whoever connects
                                              no power ─► port closed, connections cut

    one line, {"fault": "hung", "device": "hokuyo"} ──► fault port ──► on, connected, and silent

    python -m robomend_demo.devices --config FILE [--control HOST:PORT] [--end-with-parent]

The file is JSON: {"rate_hz": 10, "devices": {"jaguar": {"channel": 7}, "imu": {}}}. A device
without a channel (imu, joystick) always has power. When it is ready the process prints one line of JSON,
{"ready": true, "pid": …, "fault_port": 40122, "devices": {"jaguar": "127.0.0.1:40123", …}}; each device keeps
its address for as long as the process lives. Readings are lines of JSON, {"device": "jaguar", "seq": 7,
"value": 0.64}, at rate_hz, to every connection.

A device that is hung takes connections and says nothing until it lost its power once; one that is dead says
nothing until that fault is lifted ("none"). Each line to the fault port is answered by {"ok": true}, or by
{"ok": false, "error": …}.

When the control port goes away, the devices stay as they are (its cable is not their power) and look for it
again.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import logging
import math
import os
import signal
import socket
import sys
from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import Any

log = logging.getLogger(__name__)

MOST_CONNECTIONS = 32
MOST_WAITING = 64 * 1024
"""Bytes that may wait for one driver; one that does not read is cut off."""

PARENT_CHECK_S = 0.2


class DeviceFault(StrEnum):
    """What can be wrong with a device that has power."""

    NONE = "none"
    HUNG = "hung"
    DEAD = "dead"


class Device:
    """One device with a fixed address on loopback."""

    def __init__(self, name: str, channel: int | None, rate_hz: float) -> None:
        self.name = name
        self.channel = channel
        self.powered = False
        self.fault = DeviceFault.NONE
        self.listening = asyncio.Event()
        self._period_s = 1.0 / rate_hz
        self._connections: set[_Connection] = set()
        self._on: asyncio.Task[None] | None = None
        # Bound and never listening: it keeps the port ours while the device is off, and connecting to it is
        # refused.
        self._holder = _bound(0)
        self.port = int(self._holder.getsockname()[1])

    @property
    def address(self) -> str:
        return f"127.0.0.1:{self.port}"

    def power(self, on: bool) -> None:
        """Give or take power."""
        if on == self.powered:
            return
        self.powered = on
        log.info("%s: power %s", self.name, "on" if on else "off")
        if self.fault is DeviceFault.HUNG and not on:
            self.fault = DeviceFault.NONE
        if on:
            self._on = asyncio.create_task(self._live(), name=self.name)
        elif self._on is not None:
            self._on.cancel()
            self._on = None

    async def close(self) -> None:
        task = self._on
        self.power(False)
        if task is not None:
            await asyncio.gather(task, return_exceptions=True)
        self._holder.close()

    async def _live(self) -> None:
        loop = asyncio.get_running_loop()
        server = await loop.create_server(lambda: _Connection(self._connections), sock=_bound(self.port))
        self.listening.set()
        try:
            began, number = loop.time(), 0
            while True:
                self._send(number)
                number += 1
                # Measured from the start, so that lateness does not add up and the rate stays what it is.
                await asyncio.sleep(began + number * self._period_s - loop.time())
        finally:
            self.listening.clear()
            server.close()
            for connection in tuple(self._connections):
                connection.transport.abort()

    def _send(self, number: int) -> None:
        if self.fault is not DeviceFault.NONE:
            return
        value = round(math.sin(number * self._period_s), 6)
        line = json.dumps({"device": self.name, "seq": number, "value": value}).encode() + b"\n"
        for connection in tuple(self._connections):
            if connection.transport.get_write_buffer_size() > MOST_WAITING:
                connection.transport.abort()
            else:
                connection.transport.write(line)


class _Connection(asyncio.Protocol):
    """A driver's connection to a device."""

    transport: asyncio.Transport

    def __init__(self, connections: set[_Connection]) -> None:
        self._connections = connections

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)
        self.transport = transport
        if len(self._connections) >= MOST_CONNECTIONS:
            transport.abort()
            return
        # Else the kernel would keep megabytes of old readings for a driver that does not read.
        transport.get_extra_info("socket").setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, MOST_WAITING)
        self._connections.add(self)

    def connection_lost(self, error: Exception | None) -> None:
        self._connections.discard(self)


def _bound(port: int) -> socket.socket:
    """Return a socket bound to a loopback port. SO_REUSEADDR lets holder and listener share it on Linux."""
    bound = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    bound.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    bound.bind(("127.0.0.1", port))
    return bound


@dataclass(slots=True)
class Devices:
    """All devices of the robot, by name."""

    devices: dict[str, Device] = field(default_factory=dict)

    @classmethod
    def of(cls, config: dict[str, Any]) -> Devices:
        rate_hz = float(config.get("rate_hz", 10.0))
        return cls(
            {name: Device(name, entry.get("channel"), rate_hz) for name, entry in config["devices"].items()}
        )

    def power_channel(self, channel: int, on: bool) -> None:
        for device in self.devices.values():
            if device.channel == channel:
                device.power(on)

    async def take_faults(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Serve a connection to the fault port."""
        try:
            while line := await reader.readline():
                writer.write(json.dumps(self._take_fault(line)).encode() + b"\n")
                await writer.drain()
        except (OSError, ValueError) as error:  # ValueError: a line without end
            log.warning("the fault port: %s", error)
        finally:
            writer.close()

    def _take_fault(self, line: bytes) -> dict[str, Any]:
        try:
            asked = json.loads(line)
            device, fault = self.devices[asked["device"]], DeviceFault(asked["fault"])
        except (ValueError, KeyError, TypeError) as error:
            return {"ok": False, "error": f"{type(error).__name__}: {error}"}
        device.fault = fault
        log.info("%s: fault %s", device.name, fault)
        return {"ok": True}

    async def power_rest(self) -> None:
        """Give power to the devices that no channel feeds, and wait until they are there."""
        rest = [device for device in self.devices.values() if device.channel is None]
        for device in rest:
            device.power(True)
        for device in rest:
            await device.listening.wait()

    async def follow(self, host: str, port: int) -> None:
        """Follow the board's channels, for ever; see robomend_board/control.py for the lines."""
        wait_s = 0.05
        while True:
            try:
                async with asyncio.timeout(5.0):
                    reader, writer = await asyncio.open_connection(host, port)
                try:
                    writer.write(b'{"watch": true}\n')
                    wait_s = 0.05
                    async for line in reader:
                        told = json.loads(line)
                        if "channel" in told:
                            self.power_channel(int(told["channel"]), bool(told["powered"]))
                finally:
                    writer.close()
                log.warning("the board's control port closed the connection; looking for it again")
            except (OSError, ValueError, KeyError, TypeError) as error:
                log.warning("the board's control port at %s:%d: %s; trying again", host, port, error)
            await asyncio.sleep(wait_s)
            wait_s = min(1.0, wait_s * 2)

    async def close(self) -> None:
        await asyncio.gather(*(device.close() for device in self.devices.values()))


async def _run(config: dict[str, Any], control: tuple[str, int] | None, end_with_parent: bool) -> None:
    ended = asyncio.Event()
    loop = asyncio.get_running_loop()
    for number in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(number, ended.set)
    devices = Devices.of(config)
    tasks = []
    if control is not None:
        tasks.append(asyncio.create_task(devices.follow(*control)))
    if end_with_parent:
        tasks.append(asyncio.create_task(_until_orphan(ended)))
    await devices.power_rest()
    faults = await asyncio.start_server(devices.take_faults, "127.0.0.1", 0)
    fault_port = faults.sockets[0].getsockname()[1]
    addresses = {name: device.address for name, device in devices.devices.items()}
    ready = {"ready": True, "pid": os.getpid(), "fault_port": fault_port, "devices": addresses}
    print(json.dumps(ready), flush=True)
    await ended.wait()
    faults.close()
    for task in tasks:
        task.cancel()
    await asyncio.gather(*tasks, return_exceptions=True)
    await devices.close()


async def _until_orphan(ended: asyncio.Event) -> None:
    """An orphan gets another parent: that is how a kill -9 of whoever started us shows."""
    parent = os.getppid()
    while os.getppid() == parent:
        await asyncio.sleep(PARENT_CHECK_S)
    ended.set()


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        prog="robomend_demo.devices", description="Simulated devices of a robot."
    )
    parser.add_argument("--config", type=Path, required=True, metavar="FILE")
    parser.add_argument("--control", metavar="HOST:PORT", help="the board emulator's control port")
    parser.add_argument("--end-with-parent", action="store_true")
    options = parser.parse_args(arguments)
    logging.basicConfig(stream=sys.stderr, level=logging.INFO, format="%(asctime)s devices: %(message)s")
    control = None
    if options.control:
        host, _, port = options.control.rpartition(":")
        control = (host, int(port))
    asyncio.run(_run(json.loads(options.config.read_text()), control, options.end_with_parent))
    return 0


if __name__ == "__main__":
    sys.exit(main())
