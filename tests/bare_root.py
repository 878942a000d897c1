"""A bare Debian, made from its packages once and kept: release files are made and tried in it.

    .debian/bookworm/plain.tar    what every Debian has (of a month, at most)
    .debian/bookworm/booting/     the same, and systemd

What a release is made in is discarded: commands run over it, in an overlay (`Chroot`), or with systemd as
process 1 (tests/other_root.py).
"""

from __future__ import annotations

import fcntl
import os
import shutil
import subprocess
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from tests.other_root import KEPT, PATH
from tests.packages import Wanted

SUITE = "bookworm"
PYTHON = "3.11"
"""Of that Debian: what is built for it runs on this one only."""

KEPT_S = 30 * 24 * 3600
LONGEST_S = 1200

PLACE = Path(__file__).parents[1] / ".debian" / SUITE

TOOLS = Wanted(
    "what makes a Debian and images",
    lambda: shutil.which("mmdebstrap") and shutil.which("buildah"),
    ("mmdebstrap", "buildah"),
)

RUN = """
set -eu
root=$1 base=$2 upper=$3 work=$4
shift 4
mount -t overlay overlay -o "lowerdir=$base,upperdir=$upper,workdir=$work" "$root"
mount -t proc proc "$root/proc"
mount -t tmpfs tmp "$root/tmp"
for device in null zero full random urandom; do
    touch "$root/dev/$device"
    mount --bind "/dev/$device" "$root/dev/$device"
done
while [ "$1" != -- ]; do
    mkdir -p "$root$2"
    mount --bind "$1" "$root$2"
    shift 2
done
shift
exec chroot "$root" "$@"
"""


class NoRoot(Exception):
    """None can be made here; the message says why."""


@dataclass(frozen=True)
class Chroot:
    """Another root: `base`, and what is written over it, which stays in `folder`."""

    base: Path
    folder: Path

    @property
    def upper(self) -> Path:
        return self.folder / "upper"

    def run(self, *command: str, binds: Sequence[tuple[Path, str]] = ()) -> str:
        """Run a command as root, in this computer's network; return what it wrote. `binds`: folders of ours.

        Raises:
            NoRoot: no overlay can be mounted here, or the command failed.
        """
        places = [self.folder / name for name in ("root", "upper", "work")]
        for place in places:
            place.mkdir(parents=True, exist_ok=True)
        # Mounts and processes are of namespaces of their own: nothing of them is left when it ends.
        spaces = ("--mount", "--pid", "--fork", "--kill-child", "--propagation", "private")
        bound = [str(one) for bind in binds for one in bind]
        kept = [f"{name}={value}" for name, value in os.environ.items() if name.lower().endswith("_proxy")]
        anew = ["env", "-i", f"PATH={PATH}", "HOME=/root", "LC_ALL=C.UTF-8", "DEBIAN_FRONTEND=noninteractive"]
        root, upper, work = map(str, places)
        given = [root, str(self.base), upper, work, *bound, "--", *anew, *kept, *command]
        done = subprocess.run(
            ["unshare", *spaces, "sh", "-c", RUN, "-", *given],
            capture_output=True,
            text=True,
            timeout=LONGEST_S,
        )
        if done.returncode:
            raise NoRoot(f"{' '.join(command)[:200]}: {(done.stderr or done.stdout).strip()[-500:]}")
        return done.stdout


def bare_root() -> Path:
    """Return the folder with both, made unless it is there.

    Raises:
        NoRoot: it cannot be made here.
    """
    if os.geteuid() != 0:
        raise NoRoot("a Debian to build in is made as root")
    if why := TOOLS.install():
        raise NoRoot(why)
    PLACE.mkdir(parents=True, exist_ok=True)
    made, tar, booting = PLACE / "made", PLACE / "plain.tar", PLACE / "booting"
    with (PLACE / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if made.exists() and time.time() - made.stat().st_mtime < KEPT_S:
            return PLACE
        made.unlink(missing_ok=True)
        shutil.rmtree(booting, ignore_errors=True)
        booting.mkdir()
        _run("mmdebstrap", "--variant=minbase", "--include=ca-certificates", SUITE, str(tar))
        _run("tar", "-xf", str(tar), "-C", str(booting))
        _add_systemd(booting)
        made.touch()
    return PLACE


def _run(*command: str) -> None:
    kept = {name: value for name, value in os.environ.items() if KEPT.match(name)}
    environment = {**kept, "PATH": PATH, "LC_ALL": "C.UTF-8", "HOME": "/root"}
    done = subprocess.run(command, capture_output=True, text=True, timeout=LONGEST_S, env=environment)
    if done.returncode:
        raise NoRoot(f"{command[0]}: {done.stderr.strip()[-500:]}")


def _add_systemd(root: Path) -> None:
    shutil.copy("/etc/resolv.conf", root / "etc" / "resolv.conf")
    apt = "apt-get -q update && apt-get -q -y --no-install-recommends install systemd && apt-get clean"
    _run(
        "unshare",
        "--mount",
        "--pid",
        "--fork",
        "chroot",
        str(root),
        "sh",
        "-c",
        f"mount -t proc proc /proc && {apt}",
    )
