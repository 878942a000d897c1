"""What `robomend attach --detach` leaves running: units of the user's systemd.

    robomend-ROVER.service          the service, unless --url names one
    robomend-ROVER-agent.service    the agent

They run while the user has a session, and always once `loginctl enable-linger` was said.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

from robomend.errors import BackendError, InputError

SYSTEMCTL_S = 60.0

UNIT = """\
[Unit]
Description=robomend: {what} of {robot}

[Service]
Type={kind}
WorkingDirectory={folder}
{environment}ExecStart={command}
Restart=always
RestartSec=1
KillMode=mixed
TimeoutStopSec=15

[Install]
WantedBy=default.target
"""


def check() -> None:
    """Check that there is a systemd of this user.

    Raises:
        InputError: what is missing.
    """
    if shutil.which("systemctl") is None:
        raise InputError("--detach needs systemd, and there is no systemctl here: leave it out")
    done = _systemctl("show-environment")
    if done.returncode:
        why = done.stderr.strip().splitlines()[:1]
        raise InputError(
            f"--detach needs a systemd of this user, and systemctl --user says: {' '.join(why)}. "
            "In a container there is none; by ssh, `loginctl enable-linger` starts one"
        )


def names(robot: str) -> tuple[str, str]:
    """Return how the units of a robot's service and agent are called."""
    return f"robomend-{robot}.service", f"robomend-{robot}-agent.service"


def runs(unit: str) -> bool:
    """Whether a unit runs now."""
    return _systemctl("is-active", "--quiet", unit).returncode == 0


def unit_text(robot: str, folder: Path, arguments: list[str], environment: Mapping[str, str]) -> str:
    """Return a unit that runs one of our modules.

    Args:
        folder: where it runs; a file `NAME.env` there, of a unit's name, has what is secret.
        arguments: the module and its arguments.
    """
    what = "the service" if "serve" in arguments else "the agent"
    lines = [f"Environment={quoted(f'{name}={value}')}\n" for name, value in environment.items()]
    lines.append(f"EnvironmentFile=-{_plain(folder / 'agent.env')}\n")
    return UNIT.format(
        what=what,
        robot=robot,
        kind="notify" if "serve" in arguments else "exec",
        folder=_plain(folder),
        environment="".join(lines),
        command=" ".join(map(quoted, [sys.executable, "-m", *arguments])),
    )


def start(unit: str, text: str) -> None:
    """Write a unit, and have it run from now on as it is written.

    Raises:
        BackendError: systemd does not start it.
    """
    home = Path(os.environ.get("XDG_CONFIG_HOME") or Path.home() / ".config")
    file = home / "systemd" / "user" / unit
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text, "utf-8")
    except OSError as error:
        raise InputError(f"{error.filename} cannot be written: {error.strerror}") from error
    for words in (["daemon-reload"], ["enable", unit], ["restart", unit]):
        done = _systemctl(*words)
        if done.returncode:
            raise BackendError(f"systemctl --user {' '.join(words)}: {done.stderr.strip()}")


def quoted(word: str) -> str:
    """Return a word as a line of a unit has it."""
    for old, new in (("\\", "\\\\"), ('"', '\\"'), ("%", "%%"), ("$", "$$"), ("\n", "\\n")):
        word = word.replace(old, new)
    return f'"{word}"'


def _plain(path: Path) -> str:
    return str(path).replace("%", "%%")


def _systemctl(*words: str) -> subprocess.CompletedProcess[str]:
    try:
        return subprocess.run(
            ["systemctl", "--user", *words],
            check=False,
            capture_output=True,
            text=True,
            timeout=SYSTEMCTL_S,
        )
    except subprocess.TimeoutExpired as error:
        raise BackendError(f"systemctl --user {' '.join(words)} did not end in {SYSTEMCTL_S:g} s") from error
