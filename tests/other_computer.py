"""Another computer, as a network namespace at the end of a cable that can be cut: for tests of a network
that splits. It needs root and a kernel that lets it; elsewhere the test is skipped with the reason.
"""

from __future__ import annotations

import os
import subprocess
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import pytest
from tests import network
from tests.packages import IPROUTE


@dataclass(frozen=True)
class OtherComputer:
    """A namespace, and the two ends of its cable: NAMEa here, NAMEb there."""

    name: str
    here: str  # our address on the cable
    there: str

    @property
    def inside(self) -> tuple[str, ...]:
        """Begin a command with this, and it runs there."""
        return ("nsenter", f"--net=/run/netns/{self.name}")

    def cut(self) -> None:
        """Lose whatever is sent, both ways; both interfaces stay up, as with a cable cut further away."""
        _tc("replace", "dev", f"{self.name}a", "root", "blackhole")
        _tc("replace", "dev", f"{self.name}b", "root", "blackhole", inside=self.inside)

    def mend(self) -> None:
        _tc("del", "dev", f"{self.name}a", "root")
        _tc("del", "dev", f"{self.name}b", "root", inside=self.inside)


@contextmanager
def other_computer() -> Iterator[OtherComputer]:
    """Make one, which is gone afterwards; skip the test where that is impossible."""
    why = "a network of its own needs root" if os.geteuid() else IPROUTE.install()
    if why:
        pytest.skip(why)
    number = os.getpid() % (1 << 14)  # a cable needs four addresses; these are for tests of networks
    place = f"198.{18 + (number >> 13)}.{(number >> 5) & 255}"
    low = (number & 31) * 8
    found = OtherComputer(f"rmend{os.getpid()}", f"{place}.{low + 1}", f"{place}.{low + 2}")
    try:
        _ip("netns", "add", found.name)
    except subprocess.CalledProcessError as error:
        pytest.skip(f"the kernel refuses a network namespace: {error.stderr.strip()}")
    try:
        with network.changing():
            try:
                there = ("peer", "name", f"{found.name}b", "netns", found.name)
                _ip("link", "add", f"{found.name}a", "type", "veth", *there)
            except subprocess.CalledProcessError as error:
                pytest.skip(f"the kernel refuses a cable between namespaces: {error.stderr.strip()}")
            _ip("link", "set", f"{found.name}a", "addrgenmode", "none")  # or an address comes a second later
            _ip("addr", "add", f"{found.here}/30", "dev", f"{found.name}a")
            _ip("link", "set", f"{found.name}a", "up")
        inside = ("-n", found.name)
        _ip(*inside, "addr", "add", f"{found.there}/30", "dev", f"{found.name}b")
        _ip(*inside, "link", "set", f"{found.name}b", "up")
        _ip(*inside, "link", "set", "lo", "up")
        try:
            yield found
        finally:
            with network.changing():  # it would go with the namespace, but only a little later
                _ip("link", "del", f"{found.name}a")
    finally:
        _ip("netns", "del", found.name)


def _ip(*words: str) -> None:
    subprocess.run(["ip", *words], check=True, capture_output=True, text=True, timeout=30)


def _tc(*words: str, inside: Sequence[str] = ()) -> None:
    command = [*inside, "tc", "qdisc", *words]
    subprocess.run(command, check=True, capture_output=True, text=True, timeout=30)
