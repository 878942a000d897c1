"""`robomend init model`: a commented model to start from."""

from __future__ import annotations

from pathlib import Path

import click

from robomend.errors import InputError

STARTER = """\
# A model of your robot. `robomend model check FILE` says what it leaves out,
# `robomend compile FILE` what it means.
robomend: 1
name: {name}

channels: 10                  # of the power board, numbered from 0
protected_channels: [2]       # never shut down: put the channel of the robot's own computer here

hardware:                     # every entry can be blamed, if some rule speaks of it
  base: {{channel: 7}}          # wired to a board channel: the service can switch it
  lidar: {{channel: 3}}
  imu: {{blame_hardware: true}} # no channel: only its driver's silence tells on it

nodes:                        # processes
  base_node: {{drives: [base], publishes: {{odom: []}}}}
  lidar_node: {{drives: [lidar], publishes: {{scan: []}}}}     # prior: 0.02 says how likely it fails
  imu_node: {{drives: [imu], publishes: {{imu_data: []}}}}
  mapper: {{publishes: {{map: [scan, odom]}}}}                            # map needs scan and odom

topics:                       # for the observers: the rate of messages, and how far it may stray
  odom: {{rate_hz: 10, tolerance_hz: 1}}
  scan: {{rate_hz: 10, tolerance_hz: 1}}
  imu_data: {{rate_hz: 100, tolerance_hz: 10}}

properties:                   # what is neither topic nor component, seen as ok(temp_cpu) or not ok(temp_cpu)
  temp_cpu: {{}}

values:                       # fields whose trends are compared: inc, dec, const, matched
  odom_yaw: {{topic: odom, field: twist.twist.angular.z}}
  imu_yaw: {{topic: imu_data, field: angular_velocity.z}}
related: [[odom_yaw, imu_yaw]]

rules:                        # your own: not, and, or, ->, <->, (…), forall and exists
  - "not ok(temp_cpu) -> ab(mapper)"
  # - "forall n in nodes, h in hardware where drives(n, h): not on(h) -> ab(n) or ab(h)"

# act_when: "ok(parked)"      # an interlock: nothing is sent to the robot unless this is observed
"""


@click.command("model")
@click.argument("path", type=click.Path(path_type=Path, dir_okay=False), default="robot.yaml")
@click.option("--name", help="The robot's name; the default is the file's.")
@click.option("--force", is_flag=True, help="Overwrite the file.")
def command(path: Path, name: str | None, force: bool) -> None:
    """Write a commented starter model to PATH (default robot.yaml)."""
    import json

    text = STARTER.format(name=json.dumps(name or path.stem, ensure_ascii=False))
    try:
        with path.open("w" if force else "x", encoding="utf-8") as file:
            file.write(text)
    except FileExistsError as error:
        raise InputError(f"{path} is there already; --force overwrites it") from error
    except OSError as error:
        raise InputError(f"{path} cannot be written: {error.strerror}") from error
    click.echo(f"wrote {path}; next: robomend model check {path}", err=True)
