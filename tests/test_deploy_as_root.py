"""The lines of docs/deploy/README.md for root and for a fleet, in a copy of this computer's root."""

from __future__ import annotations

import json
import shlex
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest
from tests.blocks import BLOCKS, Block
from tests.other_root import OtherRoot, other_root
from tests.packages import POSTGRESQL, postgresql

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
