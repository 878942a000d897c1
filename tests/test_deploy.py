"""What docs/deploy says: systemd's own checker reads the units, and the lines to install are carried out."""

from __future__ import annotations

import json
import os
import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest
from tests.blocks import BLOCKS, ROOT, Block
from tests.other_root import LEFT, OtherRoot, other_root
from tests.packages import POSTGRESQL, postgresql

UNITS = sorted((ROOT / "docs" / "deploy").glob("*.service"))
MINE = [block for block in BLOCKS if block.test == f"tests/{Path(__file__).name}"]

ASK = """
import ssl, sys, time, urllib.request
anybody = ssl._create_unverified_context()
for _ in range(600):
    try:
        print(urllib.request.urlopen(sys.argv[1] + "/healthz", context=anybody).status)
        break
    except OSError:
        time.sleep(0.1)
"""
"""Until the service answers, for a minute."""


def block(part: str) -> Block:
    [found] = [block for block in MINE if part in block.text]
    return found


def verified(unit: Path, folder: Path) -> str:
    """Return what `systemd-analyze verify` says of a unit whose program is there."""
    program = folder / "program"
    program.write_text("#!/bin/sh\n")
    program.chmod(0o755)
    copy = folder / unit.name.replace("@.", "@8601.")  # of a template, an instance
    copy.write_text(re.sub(r"^(ExecStart=)\S+", rf"\1{program}", unit.read_text(), flags=re.M))
    checker = shutil.which("systemd-analyze")
    if checker is None:
        pytest.skip("there is no systemd here, which has the checker")
    done = subprocess.run([checker, "verify", str(copy)], capture_output=True, text=True, timeout=60)
    # Units of the machine that are read besides are no concern of ours.
    return "\n".join(line for line in (done.stdout + done.stderr).splitlines() if copy.name in line)


@pytest.mark.parametrize("unit", UNITS, ids=lambda unit: unit.name)
def test_systemd_finds_nothing_amiss_in_a_unit(unit: Path, tmp_path: Path) -> None:
    assert verified(unit, tmp_path) == ""


@pytest.mark.timeout(1500)
def test_the_lines_for_pipx_put_every_command_on_the_path(tmp_path: Path, long: bool) -> None:
    if not long:
        pytest.skip("it installs everything anew, which takes minutes: --long")
    subprocess.run([sys.executable, "-m", "venv", str(tmp_path / "tools")], check=True, timeout=120)
    tools = tmp_path / "tools" / "bin"
    subprocess.run([str(tools / "pip"), "install", "--quiet", "pipx"], check=True, timeout=300)
    shutil.copytree(ROOT, tmp_path / "src", ignore=LEFT)
    apps = tmp_path / "apps"
    environment = {
        **os.environ,
        "PATH": f"{tools}:{os.environ['PATH']}",
        "PIPX_HOME": str(tmp_path / "home"),
        "PIPX_BIN_DIR": str(apps),
    }
    command = ["bash", "-euo", "pipefail", "-c", block("pipx install").text]
    done = subprocess.run(
        command, cwd=tmp_path / "src", env=environment, capture_output=True, text=True, timeout=1200
    )
    assert done.returncode == 0, done.stdout + done.stderr
    for name in ("robomend", "robomend-agent", "robomend-batch", "robomend-bench", "robomend-board"):
        asked = subprocess.run([str(apps / name), "--help"], capture_output=True, timeout=100)
        assert asked.returncode == 0, name


# --- in a copy of this computer's root, with a systemd of its own


@pytest.fixture
def root(long: bool) -> Iterator[OtherRoot]:
    if not long:
        pytest.skip("it installs everything anew, which takes minutes: --long")
    # Not below tmp_path: a folder of its upper layer may not be in what pytest keeps.
    with TemporaryDirectory(prefix="robomend-root-") as folder, other_root(Path(folder)) as found:
        found.run(
            "python3 -c 'import ensurepip' || { apt-get update; apt-get -y install python3-venv; }",
            online=True,
        )
        yield found


def carried_out(root: OtherRoot, block: Block) -> str:
    """Run a block line by line; return what the last one wrote."""
    said = ""
    for line in block.text.splitlines():
        said = root.run(line, online="pip install" in line)
    return said


def answers(root: OtherRoot, url: str) -> bool:
    return root.run(f"python3 -c {shlex.quote(ASK)} {url}").strip() == "200"


@pytest.mark.timeout(1500)
def test_the_lines_for_one_robot_give_a_service_that_systemd_looks_after(root: OtherRoot) -> None:
    said = carried_out(root, block("useradd"))
    assert "a service runs there" in said
    assert answers(root, "http://127.0.0.1:8600")
    before = root.run("systemctl show --property MainPID --value robomend").strip()
    assert root.run(f"ps -o user= -p {before}").strip() == "robomend"
    root.run(f"kill -9 {before}")
    assert answers(root, "http://127.0.0.1:8600")
    assert root.run("systemctl show --property MainPID --value robomend").strip() not in ("0", before)
    root.run("systemctl disable --now robomend")


@pytest.mark.timeout(1500)
def test_the_lines_for_a_smaller_installation_give_one_without_numpy_that_plans(root: OtherRoot) -> None:
    carried_out(root, block("lean.txt"))
    seen = '--observe "not on(jaguar)" --observe "not ok(odom)" --format json'
    said = root.run(f"/opt/robomend/bin/robomend plan examples/tedusar.yaml {seen}")
    assert json.loads(said)["plan"]["planner"] == "dijkstra"
    assert "numpy" not in root.run("/opt/robomend/bin/pip list")


@pytest.mark.timeout(1500)
def test_the_lines_for_a_fleet_serve_with_a_certificate_on_a_database_elsewhere(root: OtherRoot) -> None:
    why = POSTGRESQL.install()
    programs = postgresql()
    assert programs is not None, why
    # Another computer called db, as far as this one can tell; the reader's part.
    root.run("echo '127.0.0.2 db' >> /etc/hosts")
    root.run("install -d -o postgres /srv/db")
    as_postgres = "runuser -u postgres --"
    root.run(f"{as_postgres} {programs}/initdb -D /srv/db/data --auth=trust")
    options = "-c listen_addresses=127.0.0.2 -c unix_socket_directories=/srv/db"
    root.run(f"{as_postgres} {programs}/pg_ctl -D /srv/db/data -w -l /srv/db/log -o '{options}' start")
    root.run(f"{as_postgres} {programs}/createuser -h 127.0.0.2 robomend")
    root.run(f"{as_postgres} {programs}/createdb -h 127.0.0.2 -O robomend robomend")
    root.run("openssl req -x509 -newkey rsa:2048 -nodes -subj /CN=here -days 2 -keyout key.pem -out cert.pem")
    root.run("python3 -m venv /opt/fleet")
    install, keys, serve = block("postgresql://").text.splitlines()
    here = "PATH=/opt/fleet/bin:$PATH"
    root.run(f"{here}; {install}", online=True)
    root.run(f"{here}; {keys}")
    root.run(f"{here}; systemd-run --unit=fleet --working-directory=$PWD --setenv=PATH=$PATH {serve}")
    assert answers(root, "https://127.0.0.1:8600"), root.run("journalctl -u fleet")
    root.run("systemctl stop fleet")
    assert root.run("systemctl show --property Result --value fleet").strip() == "success"
