"""What tests need beyond their own Python packages: installed if it is missing, one after another.

`./dev test` runs this before the tests, as two workers must not install at once, and a test's time is
limited; `./dev test PATH` has what the tests there need. Tests that are started in another way install what
they need themselves, under the same lock.
"""

from __future__ import annotations

import fcntl
import os
import platform
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

ROS1_PYTHON = "/usr/bin/python3"
"""The distribution's own: rospy is a package of it."""

ROS1_IMPORTS = (
    "import rospy, rosmaster.master, actionlib, rosbag, genpy.dynamic, diagnostic_msgs, geometry_msgs"
)

AGGREGATOR_NODE = "/usr/lib/diagnostic_aggregator/aggregator_node"
AGGREGATOR_LIBRARY = f"/usr/lib/{platform.machine()}-linux-gnu/libdiagnostic_aggregator.so.1d"

FAKETIME_LIBRARY = Path(f"/usr/lib/{platform.machine()}-linux-gnu/faketime/libfaketime.so.1")

ROS2_ENVIRONMENTS = Path(__file__).parents[1] / ".venv-ros2"
ROS2_IMPORTS = "import rclpy, std_msgs.msg, sensor_msgs.msg, diagnostic_msgs.msg"


@dataclass(frozen=True)
class Wanted:
    """Packages of Debian, and what one gets by them."""

    what: str
    there: Callable[[], object]
    packages: tuple[str, ...]

    def install(self) -> str:
        """Install it unless it is there; return why it is not, or nothing."""
        if self.there():
            return ""
        if os.geteuid() != 0 or shutil.which("apt-get") is None:
            return f"install {self.what} (Debian: apt-get install {' '.join(self.packages)})"
        with (Path(tempfile.gettempdir()) / "robomend-tests-packages.lock").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            if self.there():
                return ""
            apt = ["apt-get", "-q", "-y", "-o", "DPkg::Lock::Timeout=300"]
            quiet = {**os.environ, "DEBIAN_FRONTEND": "noninteractive"}
            subprocess.run([*apt, "update"], check=False, capture_output=True, timeout=300, env=quiet)
            install = [*apt, "install", "--no-install-recommends", *self.packages]
            done = subprocess.run(
                install, check=False, capture_output=True, text=True, timeout=900, env=quiet
            )
        return "" if self.there() else f"{self.what} cannot be installed: {done.stderr.strip()[-300:]}"


def postgresql() -> Path | None:
    """Return the folder of PostgreSQL's programs."""
    found = sorted(Path("/usr/lib/postgresql").glob("*/bin/initdb"))
    if found:
        return found[-1].parent
    initdb = shutil.which("initdb")
    return None if initdb is None else Path(initdb).resolve().parent


def headless_shell() -> str | None:
    """Return the path of Chromium without the program around its pages, which takes most of the processor.

    Debian's is run without its script, which would leave it behind: the kernel ends the script only.
    """
    return shutil.which("/usr/lib/chromium/chromium-headless-shell") or shutil.which("chrome-headless-shell")


def chromium() -> str | None:
    """Return the path of a Chromium: where there is no headless shell, of a whole one."""
    whole = ("chromium", "chromium-browser", "google-chrome")
    return headless_shell() or next(filter(None, map(shutil.which, whole)), None)


def ros1() -> bool:
    """Return whether there is a rospy, a master and actionlib."""
    try:
        asked = [ROS1_PYTHON, "-c", ROS1_IMPORTS]
        return subprocess.run(asked, check=False, capture_output=True).returncode == 0
    except OSError:
        return False


@dataclass(frozen=True)
class WantedRos2:
    """A real rclpy from wheels, in an environment of its own: they are one person's, for tests only."""

    distribution: str
    packages: tuple[str, ...]
    what: str = "ROS 2"

    @property
    def python(self) -> Path:
        version = f"{sys.version_info.major}.{sys.version_info.minor}"
        return ROS2_ENVIRONMENTS / f"{self.distribution}-{version}" / "bin" / "python"

    def there(self) -> bool:
        """Return whether all of it is installed."""
        complete = self.python.parent.parent / "complete"
        return complete.exists() and complete.read_text() == " ".join(self.packages)

    def install(self) -> str:
        """Install it unless it is there; return why it is not, or nothing."""
        if self.there():
            return ""
        here = (sys.platform, platform.machine())
        if here != ("linux", "x86_64") or not (3, 10) <= sys.version_info < (3, 14):
            return "wheels of rclpy are for Linux on x86-64 and Python 3.10 to 3.13 only"
        folder = self.python.parent.parent
        folder.parent.mkdir(parents=True, exist_ok=True)
        with (folder.parent / "lock").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            if self.there():
                return ""
            shutil.rmtree(folder, ignore_errors=True)
            uv = shutil.which("uv")
            if uv:
                make = [uv, "venv", "--quiet", "--python", sys.executable, str(folder)]
                install = [uv, "pip", "install", "--quiet", "--python", str(self.python), *self.packages]
            else:
                make = [sys.executable, "-m", "venv", str(folder)]
                install = [str(self.python), "-m", "pip", "install", "--quiet", *self.packages]
            # What an installer that is interrupted leaves of its temporary files goes with their folder.
            with tempfile.TemporaryDirectory(prefix="robomend-") as scratch:
                environment = {**os.environ, "TMPDIR": scratch}
                for command in (make, install, [str(self.python), "-c", ROS2_IMPORTS]):
                    done = subprocess.run(
                        command, check=False, capture_output=True, text=True, timeout=900, env=environment
                    )
                    if done.returncode:
                        return (
                            f"rclpy ({self.distribution}) cannot be installed: {done.stderr.strip()[-300:]}"
                        )
            (folder / "complete").write_text(" ".join(self.packages))
        return ""


POSTGRESQL = Wanted("a PostgreSQL server", postgresql, ("postgresql",))
CHROMIUM = Wanted(
    "Chromium's headless shell", headless_shell, ("chromium-headless-shell", "fonts-dejavu-core")
)
ROS1 = Wanted(
    "ROS 1",
    ros1,
    (
        *("python3-rospy", "python3-rosmaster", "python3-actionlib", "python3-rosbag", "python3-genpy"),
        *("python3-std-msgs", "python3-diagnostic-msgs", "python3-geometry-msgs"),
    ),
)
AGGREGATOR = Wanted(
    "ROS 1's diagnostic aggregator",
    lambda: Path(AGGREGATOR_NODE).exists() and Path(AGGREGATOR_LIBRARY).exists(),
    ("libdiagnostic-aggregator-tools",),
)
ROSLAUNCH = Wanted("ROS 1's roslaunch", lambda: shutil.which("roslaunch"), ("python3-roslaunch",))
FAKETIME = Wanted("libfaketime", FAKETIME_LIBRARY.exists, ("libfaketime",))
ZSH = Wanted("zsh", lambda: shutil.which("zsh"), ("zsh",))
FISH = Wanted("fish", lambda: shutil.which("fish"), ("fish",))
IPROUTE = Wanted("the command ip", lambda: shutil.which("ip"), ("iproute2",))
KILTED = WantedRos2(
    "kilted",
    (
        *("ros-rclpy==9.1.2", "ros-rmw-fastrtps-cpp==9.3.3", "ros-std-msgs==5.5.1", "ros-sensor-msgs==5.5.1"),
        *("ros-diagnostic-msgs==5.5.1", "ros-lifecycle-msgs==2.3.0", "ros-test-msgs==2.3.0"),
        "ros-std-srvs==5.5.1",
    ),
)
JAZZY = WantedRos2(
    "jazzy",
    (
        *("ros-rclpy==7.1.6", "ros-rmw-fastrtps-cpp<=8.4.3", "ros-std-msgs==5.3.6", "ros-sensor-msgs==5.3.6"),
        "ros-diagnostic-msgs==5.3.6",
    ),
)


BRIDGES = ("tests/clients/bridges", "tests/clients/robomend_ros")

NEEDED: dict[Wanted | WantedRos2, tuple[str, ...]] = {
    POSTGRESQL: ("tests/store", "tests/service"),
    CHROMIUM: ("tests/web",),
    FAKETIME: (*BRIDGES, "tests/service"),
    IPROUTE: BRIDGES,
    ROS1: BRIDGES,
    AGGREGATOR: BRIDGES,
    KILTED: BRIDGES,
    JAZZY: BRIDGES,
}
"""Folders most of whose tests need it; where a single test does, it installs it."""


def needed(arguments: Sequence[str]) -> list[Wanted | WantedRos2]:
    """Return what tests need that are started with these arguments: all of it where no path is named."""
    paths = [Path(one.partition("::")[0]) for one in arguments if not one.startswith("-")]
    named = [path.absolute() for path in paths if path.exists()]
    root = Path(__file__).absolute().parents[1]

    def meets(folder: Path) -> bool:
        return any(folder.is_relative_to(path) or path.is_relative_to(folder) for path in named)

    return [one for one, where in NEEDED.items() if not named or any(meets(root / place) for place in where)]


def main(arguments: Sequence[str]) -> None:
    """Install what is needed; what cannot be is said, and the tests that need it say so again."""
    for wanted in needed(arguments):
        if not wanted.there():
            print(f"tests: installing {wanted.what}", file=sys.stderr)
        why = wanted.install()
        if why:
            print(f"tests: {why}", file=sys.stderr)


def run(arguments: Sequence[str]) -> None:
    """Do that as a command, which Ctrl-C ends without a traceback."""
    try:
        main(arguments)
    except KeyboardInterrupt:
        print("tests: interrupted; what was being installed is installed anew the next time", file=sys.stderr)
        raise SystemExit(130) from None


if __name__ == "__main__":
    run(sys.argv[1:])
