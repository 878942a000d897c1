"""The files of ./dev release, installed as a stranger would: packages on a bare Debian, the image.

`./dev release` runs it on what it has made; by hand: pytest tests/test_release_files.py --release dist. It
takes minutes and Debian's packages, so the other tests do without it.
"""

from __future__ import annotations

import json
import os
import shlex
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest
from tests.bare_root import NoRoot, bare_root
from tests.blocks import ROOT
from tests.other_root import OtherRoot, other_root
from tests.test_installing import steps
from tests.waiting import until

pytestmark = pytest.mark.timeout(1500)

AGENT = """\
robot: r1
agent: onboard
service: {{url: "http://127.0.0.1:{port}"{key}}}
processes:
  jaguar_node:
    command: [sleep, infinity]
    start: true
"""

REPORT = """
import sys
from pathlib import Path
from robomend_client.rest import Client

url, key = sys.argv[1], sys.argv[2] or None
with Client(url, key) as client:
    client.put_model("tedusar", sys.stdin.read())
    client.put_robot("r1", {"model": "tedusar", "policy": "observe"})
    client.observe("r1", ["not on(jaguar)", "not ok(odom)"])
"""

DIAGNOSED = """
import json, sys
from robomend_client.rest import Client

with Client(sys.argv[1], sys.argv[2] or None) as client:
    found = client.diagnosis("r1", wait_s=60, after=0)["result"]
    print(json.dumps([one["bad"] for one in found["diagnoses"]]))
"""

SEEN = """
import sys, time
from robomend_client.rest import Client

with Client(sys.argv[1], sys.argv[2] or None) as client:
    for _ in range(600):
        if "running(jaguar_node)" in str(client.observations("r1")):
            print("seen")
            break
        time.sleep(0.1)
"""
"""What the agent reports, for a minute."""

URL = "http://127.0.0.1:8600"

HEALTH = f"import urllib.request as u; print(u.urlopen('{URL}/healthz').status)"


@pytest.fixture(scope="module")
def files(request: pytest.FixtureRequest) -> Path:
    folder: Path | None = request.config.getoption("--release")
    if folder is None:
        pytest.skip("it wants the files of a release, and takes minutes: ./dev release")
    return folder.absolute()


def one(files: Path, pattern: str) -> Path:
    [found] = files.glob(pattern)
    return found


# --- the packages


@pytest.fixture
def debian(files: Path) -> Iterator[OtherRoot]:
    try:
        base = bare_root() / "booting"
    except NoRoot as why:
        pytest.skip(str(why))
    # Not below tmp_path: a folder of its upper layer may not be in what pytest keeps.
    with TemporaryDirectory(prefix="robomend-root-") as folder, TemporaryDirectory() as source:
        for package in files.glob("*.deb"):
            os.link(package, Path(source) / package.name)
        shutil.copy(ROOT / "examples" / "tedusar.yaml", source)
        with other_root(Path(folder), base, Path(source)) as root:
            yield root


def installed(root: OtherRoot, *packages: str, more: str = "") -> str:
    """Install packages as a person does, with what they depend on from Debian."""
    named = " ".join(f"./{name}" for name in packages)
    update = "apt-get -q update && " if not more else ""
    quiet = "DEBIAN_FRONTEND=noninteractive apt-get -q -y --no-install-recommends"
    return root.run(f"{update}{quiet} {more} install {named}", online=True)


def asked(root: OtherRoot, script: str, given: str = "/dev/null") -> str:
    return root.run(f"/opt/robomend/bin/python -c {shlex.quote(script)} {URL} '' < {given}").strip()


def answers(root: OtherRoot) -> None:
    """Wait for the service that systemd has started."""
    look = f"/opt/robomend/bin/python -c {shlex.quote(HEALTH)} || true"
    until(lambda: "200" in root.run(look).splitlines(), "the service is up", 120)


def newer(root: OtherRoot, name: str, version: str, line: str = ":") -> str:
    """Make a package of a later version, whose files `line` changes; return its name."""
    target = f"{name}_{version}.deb"
    root.run(
        f"dpkg-deb -R {name}_*_*.deb made-{version} && cd made-{version} && {line.strip()} && cd .. && "
        f"sed -i 's/^Version: .*/Version: {version}/' made-{version}/DEBIAN/control && "
        f"dpkg-deb --root-owner-group -Znone -b made-{version} {target} && rm -r made-{version}"
    )
    return target


LATER_SCHEMA = r"""
store=$(echo opt/robomend/lib/python3*/site-packages/robomend/store)
now=$(sed -n 's/^HEAD = "\(.*\)"$/\1/p' $store/schema.py)
sed -i 's/^HEAD = .*/HEAD = "99"/' $store/schema.py
printf 'revision = "99"\ndown_revision = "%s"\n\ndef upgrade():\n    pass\n' $now > later.py
mv later.py $store/migrations/versions/99_later.py
rm -f $store/__pycache__/schema.*
"""
"""In a package's tree: a version that keeps its data in another way."""

PURGED = (
    "ls -d /var/lib/robomend* /etc/robomend/* /opt/* 2> /dev/null || true; "
    "getent passwd | grep robomend || true"
)


def test_the_packages_give_a_robot_that_is_diagnosed_upgraded_rolled_back_and_left_clean(
    debian: OtherRoot,
) -> None:
    names = debian.run("ls *.deb").split()
    assert sorted(name.partition("_")[0] for name in names) == ["robomend", "robomend-agent"]
    installed(debian, *names)
    answers(debian)
    process = "systemctl show --property MainPID --value"
    main = debian.run(f"{process} robomend").strip()
    assert debian.run(f"stat -c %U /proc/{main}").strip() == "robomend"
    assert debian.run("stat -c '%U %a' /var/lib/robomend").split() == ["robomend", "700"]

    asked(debian, REPORT, "tedusar.yaml")
    assert json.loads(asked(debian, DIAGNOSED)) == [["jaguar"]]
    assert "r1" in debian.run("robomend status")
    assert "Model Context Protocol" in debian.run("robomend mcp --help")

    # Nobody has configured the robot's side yet: it waits for its file.
    assert debian.run("systemctl is-enabled robomend-agent").strip() == "enabled"
    assert debian.run("systemctl is-active robomend-agent || true").strip() == "inactive"
    file = AGENT.format(port=8600, key="")
    debian.run(f"printf %s {shlex.quote(file)} > /etc/robomend/agent.yaml; systemctl start robomend-agent")
    assert asked(debian, SEEN) == "seen", debian.run("journalctl -u robomend-agent")
    agent = debian.run(f"{process} robomend-agent").strip()
    assert debian.run(f"stat -c %U /proc/{agent}").strip() == "robomend-agent"

    # A person's settings, an upgrade, and the way back.
    debian.run("echo 'log_level: warning' >> /etc/robomend/robomend.yaml")
    version = debian.run("dpkg-query -f '${Version}' -W robomend").strip()
    later = f"{version}+1"
    packages = [newer(debian, name, later) for name in ("robomend", "robomend-agent")]
    said = installed(debian, *packages, more="-o Dpkg::Options::=--force-confold")
    assert "systemctl restart robomend-agent" in said
    answers(debian)
    assert debian.run(f"{process} robomend").strip() not in ("0", main)
    assert debian.run(f"{process} robomend-agent").strip() == agent, "a robot's processes were restarted"
    assert json.loads(asked(debian, DIAGNOSED)) == [["jaguar"]]
    assert "log_level: warning" in debian.run("cat /etc/robomend/robomend.yaml")
    first = [name for name in names if not name.startswith("robomend-agent")]
    installed(debian, *first, more="--allow-downgrades")
    answers(debian)
    assert debian.run("dpkg-query -f '${Version}' -W robomend").strip() == version
    assert json.loads(asked(debian, DIAGNOSED)) == [["jaguar"]]

    # The same where the later version keeps its data in another way: back with the copy that was made before.
    data = "/var/lib/robomend"
    as_service = "runuser -u robomend --"
    debian.run(f"{as_service} robomend export --data {data} --format sqlite -o {data}/before.db")
    installed(
        debian, newer(debian, "robomend", f"{version}+2", LATER_SCHEMA), more="-o DPkg::Lock::Timeout=9"
    )
    answers(debian)
    installed(debian, *first, more="--allow-downgrades")
    until(lambda: "a newer robomend" in debian.run("journalctl -u robomend"), "it refuses a newer schema", 60)
    debian.run(
        f"systemctl stop robomend && rm -r {data}/robomend.db* && mv {data}/before.db {data}/robomend.db"
    )
    debian.run("systemctl reset-failed robomend; systemctl start robomend")
    answers(debian)
    assert json.loads(asked(debian, DIAGNOSED)) == [["jaguar"]]

    debian.run("DEBIAN_FRONTEND=noninteractive apt-get -q -y remove robomend robomend-agent")
    assert (
        debian.run(
            "ls -d /opt/* 2> /dev/null || true; systemctl is-active robomend robomend-agent || true"
        ).split()
        == ["inactive"] * 2
    )
    assert "robomend.db" in debian.run("ls /var/lib/robomend")
    debian.run("DEBIAN_FRONTEND=noninteractive apt-get -q -y purge robomend robomend-agent")
    left = debian.run(PURGED)
    assert left.split() == ["/etc/robomend/agent.yaml"]  # a person wrote it


# --- the image


def test_the_image_has_a_service_and_an_agent_that_run(files: Path, tmp_path: Path) -> None:
    if shutil.which("buildah") is None or os.geteuid() != 0:
        pytest.skip("images are unpacked by buildah, as root")
    archive = one(files, "*.oci.tar")
    with TemporaryDirectory(prefix="robomend-image-") as store:
        buildah = [
            "buildah",
            "--root",
            f"{store}/store",
            "--runroot",
            f"{store}/run",
            "--storage-driver",
            "vfs",
        ]

        def run(*command: str, given: str = "") -> str:
            done = subprocess.run(command, input=given, capture_output=True, text=True, timeout=600)
            assert done.returncode == 0, f"{command}\n{done.stdout}{done.stderr}"
            return done.stdout.strip()

        image = run(*buildah, "pull", f"oci-archive:{archive}")
        container = run(*buildah, "from", "--pull-never", image)
        config = json.loads(run(*buildah, "inspect", container))["Docker"]["config"]
        agent_file = tmp_path / "agent.yaml"
        # OCI has no place for it; Docker and Podman have, where they build the file themselves.
        health = json.loads(dict(steps())["HEALTHCHECK"].partition("CMD ")[2])

        # A network of its own: its port is taken by nobody.
        network = subprocess.Popen(
            ["unshare", "--net", "sh", "-c", "ip link set lo up && echo up && exec sleep 1200"],
            stdout=subprocess.PIPE,
            text=True,
        )
        started: list[subprocess.Popen[bytes]] = []
        try:
            assert network.stdout is not None
            assert network.stdout.readline() == "up\n"
            inside = [
                "nsenter",
                f"--net=/proc/{network.pid}/ns/net",
                *buildah,
                "run",
                "--isolation",
                "chroot",
            ]

            def within(*words: str, given: str = "", options: tuple[str, ...] = ()) -> str:
                return run(*inside, *options, container, "--", *words, given=given)

            program = config["Entrypoint"][0]
            assert within("id", "-un") == "robomend"
            key = within(program, "keys", "create", "--role", "admin", "--data", "/var/lib/robomend").split()[
                -1
            ]
            assert key.startswith("rm_")
            started.append(subprocess.Popen([*inside, container, "--", program, *config["Cmd"]]))
            python = f"{Path(program).parent}/python"

            def healthy() -> bool:
                assert started[0].poll() is None, "the service ended"
                probe = [*inside, container, "--", *health]
                return subprocess.run(probe, capture_output=True, timeout=60).returncode == 0

            until(healthy, "the image's service is healthy", 120)
            within(python, "-c", REPORT, URL, key, given=(ROOT / "examples" / "tedusar.yaml").read_text())
            assert json.loads(within(python, "-c", DIAGNOSED, URL, key)) == [["jaguar"]]

            agent_file.write_text(AGENT.format(port=8600, key=", key_env: ROBOMEND_KEY"))
            agent_file.chmod(0o644)
            mount = ("--volume", f"{agent_file}:/var/lib/robomend/agent.yaml:ro")
            agent = [
                *inside,
                *mount,
                container,
                *("--", "env", f"ROBOMEND_KEY={key}"),
                f"{Path(program).parent}/robomend-agent",
                "agent.yaml",
            ]
            started.append(subprocess.Popen(agent))
            assert within(python, "-c", SEEN, URL, key) == "seen"
        finally:
            for process in reversed(started):
                process.terminate()
            for process in started:
                process.wait(60)
            network.kill()
            network.wait(60)
