"""A copy of this computer's root, or of a bare Debian, with a systemd of its own: to install as root.

    what is written ──► upper folder, gone afterwards   (overlayfs: the rest is the other root's, as it is)
    processes, mounts, network ──► namespaces           (the systemd in them is process 1, and ends them all)

It needs root, a systemd to start, and a kernel that lets us; elsewhere the test is skipped with the reason.
"""

from __future__ import annotations

import ctypes
import os
import re
import shlex
import shutil
import signal
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

import pytest
from tests.blocks import ROOT
from tests.waiting import until

SYSTEMD = Path("/lib/systemd/systemd")
SOURCE = Path("/usr/src/robomend")
"""Where the checkout is, in the copy."""

PATH = "/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin"
KEPT = re.compile(r"PIP_|SSL_|REQUESTS_|.*_proxy\Z", re.IGNORECASE)
"""How packages are had on this computer."""

_PR_SET_PDEATHSIG = 1

LEFT = shutil.ignore_patterns(".*", "*.egg-info", "__pycache__", "report", "site", "dist", "build")

BOOT = """
root=$1 upper=$2 work=$3 group=$4 base=$7
echo $$ > "$group/cgroup.procs"
exec unshare --mount --pid --fork --kill-child --net --uts --ipc --cgroup --propagation private \
    bash -euc '
        root=$1
        mount -t overlay overlay -o "lowerdir=$6,upperdir=$2,workdir=$3" "$root"
        mount -t proc proc "$root/proc"
        mount -t sysfs -o ro sys "$root/sys"
        mount -t cgroup2 cgroup "$root/sys/fs/cgroup"
        mount -t tmpfs run "$root/run"
        mount -t tmpfs dev "$root/dev"
        for device in null zero full random urandom tty; do
            touch "$root/dev/$device"
            mount --bind "/dev/$device" "$root/dev/$device"
        done
        mkdir "$root/dev/pts" "$root/dev/shm" "$root/.before"
        mount -t devpts -o newinstance,ptmxmode=0666 pts "$root/dev/pts"
        ln -s pts/ptmx "$root/dev/ptmx"
        ln -s /proc/self/fd "$root/dev/fd"
        ip link set lo up
        cd "$root"
        pivot_root . .before
        umount -l .before
        exec env -i container=robomend-test PATH="$4" "$5" --system --unit=basic.target
    ' - "$root" "$upper" "$work" "$5" "$6" "$base"
"""

USER = """
echo $$ > "$1/cgroup.procs"
shift
exec unshare --mount --pid --fork --kill-child --ipc --cgroup --propagation private bash -euc '
    mount -t proc proc /proc
    umount --recursive /sys/fs/cgroup
    mount -t cgroup2 cgroup /sys/fs/cgroup
    mount -t tmpfs run /run
    mkdir -p /run/systemd/system /run/user  # by the first it sees that a systemd has booted
    "$@" &
    wait
' - "$@"
"""


@dataclass(frozen=True)
class OtherRoot:
    """See the module."""

    process: int  # its systemd, as this computer counts

    def run(self, line: str, *, online: bool = False) -> str:
        """Run a line as root, in the checkout; return what it wrote. `online`: in this computer's network.

        Raises:
            AssertionError: it failed.
        """
        spaces = ("--mount", "--pid", "--uts", "--ipc", "--cgroup", *(() if online else ("--net",)))
        enter = ["nsenter", f"--target={self.process}", *spaces]
        kept = [f"{name}={value}" for name, value in os.environ.items() if KEPT.match(name)]
        anew = ["env", "-i", f"PATH={PATH}", "HOME=/root", *kept]
        done = subprocess.run(
            [*enter, *anew, "bash", "-euo", "pipefail", "-c", f"cd {SOURCE}; {line}"],
            capture_output=True,
            text=True,
            timeout=1200,
        )
        assert done.returncode == 0, f"{line}\n{done.stdout}{done.stderr}"
        return done.stdout + done.stderr


def _end_with_parent() -> None:
    """Make the kernel end it when the test process is killed."""
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)


def _groups() -> Path | None:
    """Return where control groups of the second version are."""
    for line in Path("/proc/mounts").read_text().splitlines():
        _, place, kind, *_ = line.split()
        if kind == "cgroup2":
            return Path(place)
    return None


@contextmanager
def other_root(folder: Path, base: Path = Path("/"), source: Path = ROOT) -> Iterator[OtherRoot]:
    """Make one over `base`, with what is in `source`; skip the test where that is impossible."""
    places = [folder / name for name in ("root", "upper", "work")]
    with _group(base) as group:
        for place in places:
            place.mkdir()
        shutil.copytree(source, places[1] / SOURCE.relative_to("/"), ignore=LEFT)
        words = [BOOT, "-", *map(str, places), str(group), PATH, str(SYSTEMD), str(base)]
        with _begun(folder, words, group) as outer:
            yield _booted(outer, folder / "boot.log")


@contextmanager
def user_systemd(folder: Path, config: Path) -> Iterator[Path]:
    """Have a systemd of this user, which finds its units in `config`; yield the systemctl that asks it. Skip
    the test where that is impossible.
    """
    program = folder / "programs" / "systemctl"
    program.parent.mkdir()
    with _group(Path("/")) as group:
        around = ["HOME=/root", f"XDG_CONFIG_HOME={config}", "XDG_RUNTIME_DIR=/run/user", f"PATH={PATH}"]
        manager = ["env", "-i", *around, str(SYSTEMD), "--user"]
        with _begun(folder, [USER, "-", str(group), *manager], group) as outer:
            children = Path(f"/proc/{outer.pid}/task/{outer.pid}/children")

            def up() -> bool:
                if outer.poll() is not None:
                    pytest.skip(f"no systemd runs here: {(folder / 'boot.log').read_text()[-300:]}")
                for child in children.read_text().split():
                    enter = f"exec nsenter --target={child} --mount --pid --cgroup env -i"
                    words = shlex.join([*around, "/usr/bin/systemctl"])
                    program.write_text(f'#!/bin/sh\n{enter} {words} "$@"\n')
                    program.chmod(0o755)
                    asked = [str(program), "--user", "is-system-running"]
                    told = subprocess.run(asked, capture_output=True, text=True, timeout=60).stdout.strip()
                    return told in ("running", "degraded")
                return False

            until(up, "systemd is up", 120)
            yield program


@contextmanager
def _group(base: Path) -> Iterator[Path]:
    """Have a control group of our own; skip the test where no systemd could run in it."""
    groups = _groups()
    for there, why in (
        (os.geteuid() == 0, "a systemd of its own needs root"),
        ((base / SYSTEMD.relative_to("/")).exists(), f"there is no systemd in {base}"),
        (groups, "the kernel has no control groups of the second version"),
    ):
        if not there:
            pytest.skip(why)
    assert groups is not None
    group = groups / f"robomend-test-{os.getpid()}"
    group.mkdir()
    try:
        yield group
    finally:
        for below, _, _ in os.walk(group, topdown=False):
            os.rmdir(below)  # the files in it are the kernel's


@contextmanager
def _begun(folder: Path, words: list[str], group: Path) -> Iterator[subprocess.Popen[bytes]]:
    """Run a script of bash, and end all that it started."""
    with (folder / "boot.log").open("wb") as log:
        outer = subprocess.Popen(
            ["bash", "-euc", *words], stdout=log, stderr=log, preexec_fn=_end_with_parent
        )
        try:
            yield outer
        finally:
            outer.kill()  # and with it, by --kill-child, process 1 of the namespace, and so all of them
            outer.wait(60)
            until(lambda: "populated 0" in (group / "cgroup.events").read_text(), "all has ended", 60)


def _booted(outer: subprocess.Popen[bytes], log: Path) -> OtherRoot:
    children = Path(f"/proc/{outer.pid}/task/{outer.pid}/children")

    found: list[int] = []

    def booted() -> bool:
        if outer.poll() is not None:
            pytest.skip(f"no copy of the root can be made here: {log.read_text().strip()[-300:]}")
        for child in map(int, children.read_text().split()):
            with suppress(OSError, subprocess.SubprocessError):
                if Path(f"/proc/{child}/exe").readlink().name == SYSTEMD.name:
                    enter = ["nsenter", f"--target={child}", "--mount", "--pid", "--net", "--cgroup"]
                    asked = subprocess.run(
                        [*enter, "env", "-i", f"PATH={PATH}", "systemctl", "is-system-running"],
                        capture_output=True,
                        text=True,
                        timeout=60,
                    )
                    if asked.stdout.strip() in ("running", "degraded"):
                        found.append(child)
                        return True
        return False

    until(booted, "systemd is up", 120)
    return OtherRoot(found[0])
