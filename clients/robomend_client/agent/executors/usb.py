"""The kind `reset_usb`: a USB device is reset by the kernel, as if it were unplugged and plugged in again.

    reset_usb: {kind: reset_usb, devices: {camera: "046d:0825", lidar: "10c4:ea60:0001"}}

A device is named by vendor and product, as lsusb shows them, and by its serial number where there are
several. The agent's user must be allowed to write to it (a udev rule).

Source: Linux, Documentation/driver-api/usb/usb.rst, USBDEVFS_RESET; the attributes of /sys/bus/usb/devices.
"""

from __future__ import annotations

import asyncio
import fcntl
import os
import re
from collections.abc import Iterator, Mapping
from pathlib import Path

from robomend_client.actions import FAILED, OK, Action, ActionResult, Feedback

USBDEVFS_RESET = ord("U") << 8 | 20
DEVICE = re.compile(r"(?P<vendor>[0-9a-f]{4}):(?P<product>[0-9a-f]{4})(?::(?P<serial>.+))?\Z", re.IGNORECASE)


class ResetUsb:
    """Resets USB devices."""

    sysfs = Path("/sys/bus/usb/devices")
    dev = Path("/dev/bus/usb")

    def __init__(self, name: str, devices: Mapping[str, str]) -> None:
        """
        Args:
            name: the action, as the plan has it; by default the entry's name.
            devices: the action's parameter → `VENDOR:PRODUCT`, as lsusb shows it, or `VENDOR:PRODUCT:SERIAL`.
        """
        if not devices:
            raise ValueError('devices must map a parameter to a device, e.g. {camera: "046d:0825"}')
        for device in devices.values():
            if not DEVICE.match(device):
                raise ValueError(
                    f"devices: {device!r} is no device; write VENDOR:PRODUCT as lsusb shows them"
                )
        self.name = name
        self.gives_up = False
        self.parameters = (tuple(devices),)
        self._devices = dict(devices)

    async def execute(self, action: Action, feedback: Feedback) -> ActionResult:
        device = self._devices[action.parameters[0]]
        found = list(self._nodes(device))
        if len(found) != 1:
            how = "is not plugged in" if not found else f"is plugged in {len(found)} times; name the serial"
            return ActionResult(FAILED, f"{action}: USB device {device} {how}")
        feedback(1, f"{action}: resetting {found[0]}")
        try:
            await asyncio.to_thread(_reset, found[0])
        except OSError as error:
            return ActionResult(FAILED, f"{action}: {found[0]}: {error.strerror}")
        return ActionResult(OK, f"{action}: {found[0]} was reset")

    def _nodes(self, device: str) -> Iterator[Path]:
        """Yield the device files of what is plugged in under this name."""
        wanted = DEVICE.match(device)
        assert wanted is not None
        for folder in sorted(self.sysfs.glob("*")):
            try:
                ids = [(folder / name).read_text().strip().lower() for name in ("idVendor", "idProduct")]
                bus, number = (int((folder / name).read_text()) for name in ("busnum", "devnum"))
            except (OSError, ValueError):
                continue  # an interface, or one that was just unplugged
            if ids != [wanted["vendor"].lower(), wanted["product"].lower()]:
                continue
            serial = folder / "serial"
            if wanted["serial"] and (not serial.is_file() or serial.read_text().strip() != wanted["serial"]):
                continue
            yield self.dev / f"{bus:03d}" / f"{number:03d}"


def _reset(file: Path) -> None:
    descriptor = os.open(file, os.O_WRONLY | os.O_CLOEXEC)
    try:
        fcntl.ioctl(descriptor, USBDEVFS_RESET, 0)
    finally:
        os.close(descriptor)
