"""Changes of a robot's configuration, end to end: over the real service, by a robot that reports and acts."""

from __future__ import annotations

import asyncio
import math
import random
import re
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from datetime import UTC, datetime
from html import unescape
from pathlib import Path
from typing import Any

import pytest
from httpx import ASGITransport, AsyncClient
from tests.repairs.robot import Robot, running, service
from tests.waiting import eventually, look_s

from robomend.api.runtime import Runtime
from robomend.api.views import obs_out
from robomend.errors import StateConflict
from robomend.planning.plan import in_prose
from robomend.repairs.headline import of_robot
from robomend.repairs.repair_json import change_json
from robomend.robots.batches import Batch
from robomend.robots.clock import CLOCK
from robomend.robots.health import health_of
from robomend.robots.reporters import Reporter
from robomend.store import attempts, audit, events, journal, repairs
from robomend.store.records import ANY, Paging
from robomend_client.events import Kind
from robomend_client.literals import Atom
from robomend_client.readings import Reading

pytestmark = pytest.mark.anyio

MODEL = """\
robomend: 1
name: rover
hardware:
  lidar: {channel: 3}
nodes:
  lidar_node: {drives: [lidar], publishes: {scan: []}}
  wheels_node: {publishes: {odom: []}}
properties: [visibility]
functions:
  altitude:
    prefer: [high, medium, low]
    variants:
      high: {when: "visibility >= 3.25 ± 0.1", do: ["set_mode(spiral, high)"]}
      medium: {when: "visibility >= 2.25 ± 0.1", do: ["set_mode(spiral, medium)"]}
      low: {do: ["set_mode(spiral, low)"]}
    dwell_s: 0.2
    adapt: auto
  localisation:
    variants:
      lidar: {needs: [lidar_node], do: [localise(lidar)]}
      odometry: {needs: [wheels_node], do: [localise(odometry)]}
    dwell_s: 0.2
    adapt: auto
"""

ACTIONS = {name: {"timeout_s": 5.0, "effect_timeout_s": 1.0} for name in ("set_mode", "localise")}

CONFIG: dict[str, Any] = {
    "model": "rover",
    "policy": "approve",
    "observed": ["ok(scan)", "ok(odom)", "running(lidar_node)", "running(wheels_node)", "on(lidar)"],
    "observed_timeout_s": 3.0,
    "detection_s": 0.0,
    "actions": ACTIONS,
}


FUNCTION_OF = {"set_mode": "altitude", "localise": "localisation", "map": "mapping"}


@dataclass
class Rover(Robot):
    """Works by one variant of each function, and says so."""

    active: dict[str, str] = field(default_factory=lambda: {"altitude": "high", "localisation": "lidar"})
    visibility: float = 4.0
    lidar: bool = True  # whether it answers
    driver: bool = True
    spares: dict[str, bool] = field(default_factory=dict)  # devices that are off until they are switched on
    deaf: set[str] = field(default_factory=set)  # acts that are answered with a failure
    mute: set[str] = field(default_factory=set)  # acts that do nothing
    held: asyncio.Event = field(default_factory=asyncio.Event)  # acts wait for it, if `holds`
    holds: bool = False
    begun: list[str] = field(default_factory=list)  # acts that the service knows to be begun
    says_active: bool = True

    def sentences(self) -> list[str]:
        scan = self.lidar and self.driver
        facts = {
            "on(lidar)": True,
            "running(lidar_node)": self.driver,
            "running(wheels_node)": True,
            "ok(scan)": scan,
            "ok(odom)": True,
            **{f"on({device})": on for device, on in self.spares.items()},
        }
        said = [fact if value else f"not {fact}" for fact, value in facts.items()]
        if self.says_active:
            said += [f"active({function}, {variant})" for function, variant in self.active.items()]
        return [*said, "not ok(visibility)" if self.visibility < 2 else "ok(visibility)"]

    def measured(self) -> Reading:
        """What its last sentence rests on."""
        return Reading(self.visibility, "m")

    async def report(self) -> None:
        sentences, now_ns = tuple(self.sentences()), CLOCK.now_ns()
        readings = (*[None] * (len(sentences) - 1), self.measured())
        since = (now_ns,) * len(sentences)
        batch = Batch(sentences, source="rover", time_ns=now_ns, since=since, readings=readings)
        await self.robots.observe(self.id, batch)

    async def act_for_ever(self) -> None:
        while True:
            action = await self.repairs.orders(self.id, host=None, wait_s=5.0)
            if action is None:
                continue
            text = f"{action['name']}({', '.join(action['parameters'])})"
            try:
                await self.repairs.feedback(action["id"], code=0, message="begun")
            except StateConflict:  # taken back meanwhile
                continue
            self.begun.append(text)
            if self.holds:
                await self.held.wait()
            code = 1 if text in self.deaf else 0
            if not code and text not in self.mute:
                if action["name"] in FUNCTION_OF:
                    self.active[FUNCTION_OF[action["name"]]] = action["parameters"][-1]
                elif action["name"] == "power_up":
                    self.spares[action["parameters"][0]] = True
                elif action["name"] == "start_node":
                    self.driver = True
                elif action["name"] == "stop_node":
                    self.driver = False
            self.done.append(text)
            await self.report()
            await self.repairs.result(action["id"], code=code, message="", by=Reporter("robot"))


@asynccontextmanager
async def rover_on(runtime: Runtime, model: str = MODEL, **changes: Any) -> AsyncIterator[Rover]:
    await runtime.robots.models.put("rover", model, format=None, expected=None, by="test")
    await runtime.robots.put_robot("r1", {**CONFIG, **changes}, expected=None, by="test")
    rover = Rover(runtime.repairs, runtime.robots)
    async with running(rover):
        yield rover


@asynccontextmanager
async def rover_of(data: Path, model: str = MODEL, **changes: Any) -> AsyncIterator[tuple[Runtime, Rover]]:
    """Run a service, and a rover that is well."""
    async with service(data) as runtime, rover_on(runtime, model, **changes) as rover:
        await rover.settled()
        yield runtime, rover


async def changes_of(runtime: Runtime) -> list[dict[str, Any]]:
    """The robot's changes, oldest first."""
    page = await runtime.store.read(repairs.page, "r1", Paging(limit=100), changes=True)
    return [change_json(one) for one in reversed(page.items)]


async def until(look: Callable[[], Awaitable[Any]], what: str, timeout_s: float = 60.0) -> Any:
    waited = 0.0
    while not (found := await look()):
        assert waited < timeout_s, f"waited {timeout_s:g} s in vain for {what}"
        await asyncio.sleep(step := look_s(waited))  # between two looks
        waited += step
    return found


async def ended(runtime: Runtime, count: int) -> list[dict[str, Any]]:
    """The changes, once so many have ended."""

    async def look() -> list[dict[str, Any]] | None:
        found = [one for one in await changes_of(runtime) if one["finished_ns"] is not None]
        return found if len(found) >= count else None

    found: list[dict[str, Any]] = await until(look, f"{count} changes that have ended")
    return found


def texts(changes: list[dict[str, Any]]) -> list[tuple[str, str, str]]:
    return [(one["changes"][0]["from"], one["changes"][0]["to"], one["state"]) for one in changes]


async def test_a_reading_that_falls_changes_the_variant_and_back_and_nothing_is_blamed(
    tmp_path: Path,
) -> None:
    async with rover_of(tmp_path) as (runtime, rover):
        rover.visibility = 2.9
        (change,) = await ended(runtime, 1)
        assert texts([change]) == [("high", "medium", "changed")]
        assert change["reason"] == "visibility fell to 2.9, at least 3.25"
        rover.visibility = 3.4
        first, second = await ended(runtime, 2)
        assert texts([second]) == [("medium", "high", "changed")]
        at, back = first["changed"][11:19], second["changed"][11:19]
        assert first["changes"][0]["text"] == (
            f"altitude: high → medium at {at}, as visibility fell to 2.9, at least 3.25; back at {back}"
        )
        assert rover.done == ["set_mode(spiral, medium)", "set_mode(spiral, high)"]
        assert list(await runtime.repairs.repairs("r1", before=None, limit=5)) == []
        assert await runtime.store.read(attempts.counted, "r1", 0) == {}
        assert await runtime.store.read(attempts.tried, "r1") == ()
        assert await runtime.repairs.quarantined("r1") == {}
        assert await runtime.store.read(journal.unsettled, "r1") == ()
        state = await runtime.robots.memory.robot("r1")
        assert str(health_of(state)[0]) == "healthy"
        told = await runtime.store.read(lambda view: events.after(view, 0, robot="r1", limit=10_000))
        assert [event.data["state"] for event in told if event.kind is Kind.CONFIGURATION] == [
            "running",
            "changed",
        ] * 2
        metrics = (await runtime.metrics.text()).decode()
        assert 'robomend_configuration_changes_total{state="changed"} 2.0' in metrics


async def test_a_way_back_to_a_variant_that_the_model_has_no_more_is_forgotten(tmp_path: Path) -> None:
    async with rover_of(tmp_path) as (runtime, rover):
        rover.visibility = 2.9
        await ended(runtime, 1)
        model = re.sub("      high: .*\n", "", MODEL).replace("[high, medium, low]", "[medium, low]")
        await runtime.robots.models.put("rover", model, format=None, expected=ANY, by="test")
        rover.visibility = 2.0
        await ended(runtime, 2)
        rover.visibility = 2.9
        changes = await ended(runtime, 3)
        assert texts(changes[1:]) == [("medium", "low", "changed"), ("low", "medium", "changed")]


async def test_a_change_to_a_variant_that_the_model_loses_meanwhile_ends(tmp_path: Path) -> None:
    async with rover_of(tmp_path) as (runtime, rover):
        rover.holds = True
        rover.mute.add("set_mode(spiral, medium)")
        rover.visibility = 2.9
        await eventually(lambda: "set_mode(spiral, medium)" in rover.begun, "the change")
        model = re.sub("      medium: .*\n", "", MODEL).replace("[high, medium, low]", "[high, low]")
        await runtime.robots.models.put("rover", model, format=None, expected=ANY, by="test")
        rover.held.set()
        changes = await ended(runtime, 2)
        assert texts(changes) == [("high", "medium", "failed"), ("high", "low", "changed")]


async def test_a_dead_device_is_bridged_at_once_and_the_robot_is_degraded(tmp_path: Path) -> None:
    async with rover_of(tmp_path) as (runtime, rover):
        rover.lidar = False
        (change,) = await ended(runtime, 1)
        assert texts([change]) == [("lidar", "odometry", "changed")]
        state = await runtime.robots.memory.robot("r1")
        await eventually(lambda: str(health_of(state)[0]) == "degraded", "the robot is degraded")
        assert health_of(state)[0].healthy is False
        rover.lidar = True  # a person has mended it
        changes = await ended(runtime, 2)
        assert texts(changes[1:]) == [("odometry", "lidar", "changed")]


async def test_what_may_be_broken_and_is_seen_to_work_is_changed_to(tmp_path: Path) -> None:
    """The supply of both may be what is wrong with the lidar; odometry shows that it is good enough."""
    model = MODEL.replace("lidar: {channel: 3}", "lidar: {channel: 3, fed_by: [battery]}")
    model = model.replace("hardware:", "hardware:\n  battery: {channel: 2}\n  motors: {fed_by: [battery]}")
    model = model.replace("wheels_node: {", "wheels_node: {drives: [motors], ")
    blind = "do: [localise(odometry)]}\n      blind: {do: [localise(blind)]}"
    model = model.replace("do: [localise(odometry)]}", blind)
    async with rover_of(tmp_path, model) as (runtime, rover):
        rover.lidar = False
        (change,) = await ended(runtime, 1)
        assert texts([change]) == [("lidar", "odometry", "changed")]
        assert "battery" in change["reason"]
        state = await runtime.robots.memory.robot("r1")
        await eventually(lambda: str(health_of(state)[0]) == "degraded", "the robot is degraded")


CART = """\
robomend: 1
name: cart
hardware: {lidar: {channel: 3}, receiver: {channel: 4}}
nodes:
  slam: {drives: [lidar], publishes: {pose: []}}
  gps_node: {drives: [receiver], publishes: {fix: []}}
  wheels: {publishes: {odom: []}}
properties: [satellites]
functions:
  localisation:
    variants:
      map: {needs: [slam], do: [localise(map)]}
      gps: {when: "satellites >= 6 ± 0.5", needs: [gps_node], do: [localise(gps)]}
      odometry: {needs: [wheels], do: [localise(odometry)]}
    dwell_s: 0.1
    adapt: auto
    changes_per_hour: 1000
"""

NEEDS = {"map": {"slam", "lidar"}, "gps": {"gps_node", "receiver"}, "odometry": {"wheels"}}


@dataclass
class Cart(Rover):
    """A mobile robot that knows where it is in one of three ways."""

    active: dict[str, str] = field(default_factory=lambda: {"localisation": "map"})
    broken: set[str] = field(default_factory=set)
    satellites: float = 9.0

    def sentences(self) -> list[str]:
        facts = {
            "on(lidar)": "lidar" not in self.broken,
            "on(receiver)": "receiver" not in self.broken,
            **{f"running({node})": node not in self.broken for node in ("slam", "gps_node", "wheels")},
            "ok(pose)": not self.broken & NEEDS["map"],
            "ok(fix)": not self.broken & NEEDS["gps"],
            "ok(odom)": not self.broken & NEEDS["odometry"],
        }
        said = [fact if value else f"not {fact}" for fact, value in facts.items()]
        return [*said, f"active(localisation, {self.active['localisation']})", "ok(satellites)"]

    def measured(self) -> Reading:
        return Reading(self.satellites, "")

    def disturb(self, chance: random.Random) -> None:
        """Break or mend something, or let satellites rise or set."""
        what = chance.choice(["break", "break", "mend", "satellites"])
        if what == "satellites":
            self.satellites = chance.choice([2.0, 5.8, 6.2, 9.0])
        elif (what == "break" and len(self.broken) < 2) or not self.broken:
            often = ["lidar", "lidar", "slam", "slam"]
            self.broken.add(chance.choice([*often, "receiver", "gps_node", "wheels"]))
        else:
            self.broken.remove(chance.choice(sorted(self.broken)))

    def best(self, active: str) -> str:
        """The first way that works, by its own words; of what is active a bit less is asked, of what is
        better a bit more.
        """
        order = list(NEEDS)
        for variant in order:
            better = order.index(variant) < order.index(active)
            least = 5.5 if variant == active else 6.5 if better else 6.0
            if not self.broken & NEEDS[variant] and (variant != "gps" or self.satellites >= least):
                return variant
        return active  # nothing works


@pytest.mark.parametrize("seed", [1, *(pytest.param(more, marks=pytest.mark.long) for more in (2, 3))])
async def test_twenty_disturbances_of_a_robot_with_three_ways_to_localise(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, seed: int
) -> None:
    # Time runs faster here: what is undone within four dwells, 0.4 s, was one change too many.
    monkeypatch.setattr("robomend.planning.configurations.SOON_NS", 0)
    chance, actions = random.Random(seed), {"localise": {"timeout_s": 20.0, "effect_timeout_s": 5.0}}
    async with service(tmp_path) as runtime:
        await runtime.robots.models.put("cart", CART, format=None, expected=None, by="test")
        observed = [one.removeprefix("not ") for one in Cart(None, None).sentences() if "active" not in one]
        config = {**CONFIG, "model": "cart", "observed": observed, "actions": actions}
        await runtime.robots.put_robot("r1", config, expected=None, by="test")
        async with running(cart := Cart(runtime.repairs, runtime.robots)):
            await cart.settled()
            state = await runtime.robots.memory.robot("r1")
            for _ in range(20):
                cart.disturb(chance)
                wanted = cart.best(cart.active["localisation"])
                rests_on = NEEDS[wanted]
                works = not cart.broken & rests_on and (wanted != "gps" or cart.satellites >= 5.5)
                health = ("degraded" if works else "unhealthy") if cart.broken else "healthy"

                async def as_it_should_be(wanted: str = wanted, health: str = health) -> bool:
                    active = state.function_states()["localisation"].active
                    found = (active, str(health_of(state)[0])) == (wanted, health)
                    lasted_ns = CLOCK.now_ns() - 500_000_000
                    ended_ns = [one["finished_ns"] for one in await changes_of(runtime)]
                    return found and all(at is not None and at < lasted_ns for at in ended_ns)

                await cart.settled()
                about = f"{wanted}, {health}, {cart.broken}, {cart.satellites} satellites"
                try:
                    await until(as_it_should_be, about, 60.0)
                except AssertionError as error:
                    held = state.function_states()["localisation"]
                    raise AssertionError(f"{error}: {held.held}, {held.standings}") from error
        changes = await changes_of(runtime)
        assert await runtime.store.read(attempts.tried, "r1") == ()
        assert await runtime.repairs.quarantined("r1") == {}
    assert len(changes) >= 5
    assert {one["state"] for one in changes} == {"changed"}
    assert all(one["reason"] for one in changes)


async def test_a_variant_whose_act_fails_gives_way_to_the_next_one_and_that_is_said(tmp_path: Path) -> None:
    async with rover_of(tmp_path) as (runtime, rover):
        rover.deaf.add("set_mode(spiral, medium)")
        rover.visibility = 2.9
        changes = await ended(runtime, 2)
        assert texts(changes) == [("high", "medium", "failed"), ("high", "low", "changed")]
        assert changes[0]["reason"].startswith("set_mode(spiral, medium) failed")
        rover.mute.add("set_mode(spiral, high)")
        rover.visibility = 5.0
        changes = await ended(runtime, 3)
        assert texts(changes[2:]) == [("low", "high", "failed")]
        assert "active(altitude,high) was not seen" in changes[2]["reason"]
        state = await runtime.robots.memory.robot("r1")

        def why() -> str:
            return state.function_states()["altitude"].standings["high"].why

        await eventually(lambda: why() == str(changes[2]["reason"]), "why high is not changed to")


BESIDE = """\
  mapping:
    variants:
      live: {needs: [lidar_node], do: [map(live)]}
      stored: {do: [map(stored)]}
    dwell_s: 0.2
    adapt: auto
"""
"""A second function that needs the lidar."""

BESIDE_ACTIONS = {**ACTIONS, "map": ACTIONS["localise"]}


async def test_each_function_has_its_own_end_where_one_of_two_that_lose_the_same_cannot_be_changed(
    tmp_path: Path,
) -> None:
    model = MODEL + BESIDE.replace("stored: {", "stored: {needs: [wheels_node], ")
    for what in ("deaf", "mute"):
        folder = tmp_path / what
        folder.mkdir()
        async with service(folder) as runtime, rover_on(runtime, model, actions=BESIDE_ACTIONS) as rover:
            rover.active["mapping"] = "live"
            await rover.settled()
            getattr(rover, what).add("localise(odometry)")
            rover.lidar = False
            changes = [one["changes"][0] | {"state": one["state"]} for one in await ended(runtime, 2)]
            found = {(one["function"], one["to"], one["state"], one["fault"]) for one in changes}
            assert found == {
                ("localisation", "odometry", "failed", True), ("mapping", "stored", "changed", True),
            }  # fmt: skip
            rover.lidar = True
            change = (await ended(runtime, 3))[2]
            assert texts([change]) == [("stored", "live", "changed")]
            assert len(change["changes"]) == 1
            states = (await runtime.robots.memory.robot("r1")).function_states()
            assert states["mapping"].standings["stored"].why == ""


async def test_a_change_that_costs_less_than_a_repair_comes_before_its_acts_however_many_functions_need_it(
    tmp_path: Path,
) -> None:
    config: dict[str, Any] = {"policy": "auto", "actions": BESIDE_ACTIONS}
    async with service(tmp_path) as runtime, rover_on(runtime, MODEL + BESIDE, **config) as rover:
        rover.active["mapping"] = "live"
        await rover.settled()
        rover.lidar = False
        await eventually(lambda: "stop_node(lidar_node)" in rover.done, "the repair")
        assert sorted(rover.done[:2]) == ["localise(odometry)", "map(stored)"]


async def test_a_repair_waits_until_the_next_variant_is_active_where_the_first_one_fails(
    tmp_path: Path,
) -> None:
    model = MODEL.replace(
        "do: [localise(odometry)]}", "do: [localise(odometry)]}\n      none: {do: [localise(none)]}"
    )
    async with rover_of(tmp_path, model, policy="auto") as (_, rover):
        rover.mute.add("localise(odometry)")
        rover.lidar = False
        await eventually(lambda: "stop_node(lidar_node)" in rover.done, "the repair")
        assert rover.active["localisation"] == "none"


@pytest.mark.parametrize("supply", ["of its own", "of all"])
async def test_a_fault_while_a_repair_acts_on_something_else_is_bridged_beside_it(
    tmp_path: Path, supply: str
) -> None:
    config: dict[str, Any] = {
        "policy": "auto",
        "model": "cart",
        "observed": ["ok(pose)", "ok(fix)", "ok(odom)"],
    }
    acts = ("localise", "start_node", "stop_node", "power_up", "shutdown")
    config["actions"] = dict.fromkeys(acts, ACTIONS["localise"])
    config["actions"]["stop_node"] = {
        "timeout_s": 5.0,
        "effect_timeout_s": 300.0,
    }  # nobody sees that it acted
    model = CART.replace("wheels: {publishes", "extra: {publishes: {beep: []}}\n  wheels: {publishes")
    if supply == "of all":
        model = re.sub("(channel: [34])", r"\1, fed_by: [battery]", model).replace(
            "extra: {", "extra: {drives: [horn], "
        )
        fed = "battery: {channel: 2}, horn: {channel: 5, fed_by: [battery]}"
        model = model.replace("hardware: {", f"hardware: {{{fed}, ")
    async with service(tmp_path) as runtime:
        await runtime.robots.models.put("cart", model, format=None, expected=None, by="test")
        await runtime.robots.put_robot("r1", {**CONFIG, **config}, expected=None, by="test")
        async with running(cart := Cart(runtime.repairs, runtime.robots)):
            await cart.settled()
            beep: dict[str, Any] = {"source": "ear", "since": (CLOCK.now_ns(),) * 2}
            await runtime.robots.observe("r1", Batch(("running(extra)", "not ok(beep)"), **beep))
            # It has answered, and its effect is awaited in vain: the round goes on.
            await eventually(lambda: "stop_node(extra)" in cart.done, "the repair")
            cart.broken.add("lidar")
            await eventually(lambda: cart.active["localisation"] == "gps", "the bridge")
            page = await runtime.store.read(repairs.page, "r1", Paging(limit=5), open_only=True)
            (repair,) = page.items
            assert repair.state == "running"
            assert len(repair.data["rounds"]) == 1


async def test_a_change_that_costs_more_than_a_repair_comes_once_that_was_in_vain(tmp_path: Path) -> None:
    model = MODEL.replace("hardware:", "hardware:\n  lidar_b: {channel: 4}\n  lidar_c: {channel: 5}")
    model = model.replace(
        "odometry: {needs: [wheels_node], do: [localise(odometry)]}",
        "odometry: {needs: [wheels_node], do: [power_up(lidar_b), power_up(lidar_c), localise(odometry)]}",
    )
    actions = {**ACTIONS, **{name: {"executor": {"kind": "agent"}} for name in ("power_up", "shutdown")}}
    config = {"policy": "auto", "actions": actions, "expected": {"stopped": ["lidar_b", "lidar_c"]}}
    async with service(tmp_path) as runtime, rover_on(runtime, model, **config) as rover:
        rover.spares = {"lidar_b": False, "lidar_c": False}
        await rover.settled()
        rover.lidar = False
        await eventually(lambda: "localise(odometry)" in rover.done, "the change")
        first = ["stop_node(lidar_node)", "start_node(lidar_node)"]  # in vain; power is not cut before …
        assert rover.done[:5] == [*first, "power_up(lidar_b)", "power_up(lidar_c)", "localise(odometry)"]


async def test_a_change_that_needs_a_yes_waits_for_it_and_lapses_when_it_is_not_due(tmp_path: Path) -> None:
    model = MODEL.replace(
        "dwell_s: 0.2\n    adapt: auto\n  local", "adapt: approve\n    dwell_s: 0.2\n  local"
    )
    async with rover_of(tmp_path, model) as (runtime, rover):

        async def waits(state: str = "awaiting-approval") -> dict[str, Any] | None:
            found = await changes_of(runtime)
            return found[-1] if found and found[-1]["state"] == state else None

        rover.visibility = 2.9
        change = await until(waits, "a change that waits")
        rover.visibility = 4.0
        await until(lambda: waits("cancelled"), "its end")
        rover.visibility = 2.9
        change = await until(waits, "another one")
        rover.lidar = False  # what needs no yes goes on meanwhile
        await eventually(lambda: rover.active["localisation"] == "odometry", "the other function")
        answer = await runtime.repairs.approve(change["id"], by="ada", reason="")
        assert answer["state"] in {"running", "changed"}
        with pytest.raises(StateConflict, match=f"change {change['id']} "):
            await runtime.repairs.approve(change["id"], by="ada", reason="")
        await eventually(lambda: rover.active["altitude"] == "medium", "the change")
        rover.visibility = 2.0
        change = await until(waits, "the next one")
        assert (await runtime.repairs.cancel(change["id"], by="ada", reason="not now"))[
            "state"
        ] == "cancelled"
        state = await runtime.robots.memory.robot("r1")
        await eventually(
            lambda: state.function_states()["altitude"].standings["low"].why == "declined by ada",
            "the no is remembered",
        )
        assert rover.active["altitude"] == "medium"
        page = await runtime.store.read(audit.page, robot="r1")
        said = [(entry.subject, entry.action, entry.reason) for entry in page.items if entry.actor == "ada"]
        assert said[0] == (change["id"], "change.cancelled", "not now")
        assert {subject for subject, _, _ in said} == {change["id"], answer["id"]}


async def test_what_is_only_observed_is_said_and_not_done(tmp_path: Path) -> None:
    async with rover_of(tmp_path, policy="observe") as (runtime, rover):
        rover.visibility = 2.9
        state = await runtime.robots.memory.robot("r1")
        held = "medium is due, as visibility fell to 2.9, at least 3.25; the robot is only observed"
        await eventually(lambda: state.function_states()["altitude"].held == held, "why nothing is done")
        assert await changes_of(runtime) == []


async def test_what_a_condition_compares_is_of_use_and_follows_from_no_fault(tmp_path: Path) -> None:
    async with service(tmp_path) as runtime, rover_on(runtime, policy="observe") as rover:
        rover.lidar, rover.visibility = False, 1.0
        await rover.settled()
        state = await runtime.robots.memory.robot("r1")

        await eventually(lambda: "scan" in of_robot(state, None).text(CLOCK.now_ns()), "the fault is told")
        assert "follow" not in of_robot(state, None).text(CLOCK.now_ns())
        used = {one.literal for one in obs_out(state).observations if one.used}
        assert {"not ok(visibility)", "not ok(scan)"} <= used


async def test_what_is_active_and_cannot_work_or_may_not_is_not_called_working(tmp_path: Path) -> None:
    async with rover_of(tmp_path) as (runtime, rover):
        state = await runtime.robots.memory.robot("r1")

        async def told(words: str) -> None:
            await eventually(lambda: words in of_robot(state, None).text(CLOCK.now_ns()), words)

        rover.visibility = 2.9
        await ended(runtime, 1)
        rover.visibility = math.nan
        await told("; whether it still does is unknown, as nobody reports visibility")
        rover.visibility = 2.9
        await runtime.robots.put_robot("r1", {**CONFIG, "policy": "observe"}, expected=ANY, by="test")
        rover.lidar = False
        await told("; localisation cannot work by lidar, as ")
        rover.active["localisation"] = "odometry"  # by a person
        await told("; localisation works by odometry since ")


POLICIES: dict[str, tuple[dict[str, Any], str]] = {
    "policy": ({"policy": "observe"}, "the robot is only observed"),
    "allow": (
        {"allow": ["stop_node"]},
        "set_mode(spiral, high): 'set_mode' is not on the robot's allow-list (stop_node)",
    ),
    "window": (
        {
            "windows": [
                {"weekdays": [(datetime.now(UTC).weekday() + 3) % 7], "start": "00:00", "end": "00:01"}
            ]
        },
        "no maintenance window is open",
    ),
    "adapt": ({}, "`adapt` of altitude is 'observe'"),
    "interlock": (
        {},
        "act_when of the model, `ok(parked)`, is not what is observed: not ok(parked) is observed",
    ),
}
"""What forbids the way back from medium to high, and the words for it."""

GUARDED = MODEL.replace("properties: [visibility]", "properties: [visibility, parked]\nact_when: ok(parked)")


@pytest.mark.parametrize("what", POLICIES)
async def test_a_way_back_that_is_forbidden_is_said_everywhere_and_taken_once_it_may_be(
    tmp_path: Path, what: str
) -> None:
    config, why = POLICIES[what]
    model = GUARDED.replace("adapt: auto", "", 1) if what == "window" else GUARDED
    async with service(tmp_path) as runtime, rover_on(runtime, model, policy="auto") as rover:
        http = AsyncClient(transport=ASGITransport(runtime.app), base_url="http://127.0.0.1")

        async def shown(path: str) -> Any:
            answer = await http.get(path, headers={"accept": "*/*"})
            assert answer.status_code == 200, answer.text
            return answer.text if path.startswith("/ui") else answer.json()

        async def permit(yes: bool) -> None:
            if what == "interlock":
                await runtime.robots.observe(
                    "r1", Batch(("ok(parked)" if yes else "not ok(parked)",), source="brake")
                )
            elif what == "adapt":
                text = model if yes else model.replace("adapt: auto", "adapt: observe", 1)
                await runtime.robots.models.put("rover", text, format=None, expected=ANY, by="test")
            else:
                new = {**CONFIG, "policy": "auto", **({} if yes else config)}
                await runtime.robots.put_robot("r1", new, expected=ANY, by="test")

        await runtime.robots.observe("r1", Batch(("ok(parked)",), source="brake"))
        await rover.settled()
        rover.visibility = 2.9
        await ended(runtime, 1)
        await permit(False)
        rover.visibility = 4.0

        said = f"high is admissible again, as visibility rose to 4, at least 3.25, and not changed to: {why}"

        async def held() -> bool:
            found = (await shown("/api/v1/robots/r1/functions"))["functions"]
            one = next(one for one in found if one["function"] == "altitude")
            return (one["active"], one["goal"], one["held"]) == ("medium", "high", said)

        await until(held, said)
        headline, begin = (await shown("/api/v1/robots/r1"))["headline"], in_prose(why.partition(":")[0])
        assert re.search(rf"; altitude works by medium since [0-9:]+, as {re.escape(begin)}", headline)
        rover.visibility = 4.25  # what is measured is no news to the record
        await rover.settled()
        (change,) = (await shown("/api/v1/robots/r1/changes"))["items"]
        said = f"high is admissible again, and not changed to: {why}"
        assert change["state"] == "changed"
        assert change["changes"][0]["held"] == said
        assert change["changes"][0]["text"].endswith(f"at least 3.25; {said}")
        page = re.sub("<[^>]*>", "", await shown("/ui/robots/r1"))
        assert in_prose(why) in " ".join(unescape(page).split())
        told = await runtime.store.read(lambda view: events.after(view, 0, robot="r1", limit=10_000))
        news = [event.data for event in told if event.kind is Kind.CONFIGURATION]
        assert [one["state"] for one in news] == ["running", "changed", "changed"]
        assert news[-1]["held"] == said
        metrics = (await runtime.metrics.text()).decode()
        assert 'robomend_configuration_changes_total{state="changed"} 1.0' in metrics
        assert list(await runtime.repairs.repairs("r1", before=None, limit=5)) == []
        await permit(True)
        changes = await ended(runtime, 2)
        assert texts(changes[1:])[0][:2] == ("medium", "high")


async def test_nothing_is_changed_by_an_active_variant_that_nobody_reports_or_by_two(tmp_path: Path) -> None:
    async with service(tmp_path) as runtime, rover_on(runtime) as rover:
        rover.says_active = False
        rover.visibility = 1.0
        await rover.settled()
        state = await runtime.robots.memory.robot("r1")
        held = "nobody reports which variant of altitude is active"

        await eventually(lambda: state.function_states()["altitude"].held == held, held)
        asks = f"{held}: it is not changed before one is, as active(altitude, …)"
        assert asks in await runtime.repairs.findings("r1")
        two = ("active(altitude, high)", "active(altitude, low)")
        await runtime.robots.observe("r1", Batch(two, source="rover"))
        several = "several variants of altitude are reported active: high, low"
        await eventually(lambda: state.function_states()["altitude"].held == several, several)
        assert f"{several}: it is not changed before one is, as active(altitude, …)" in (
            await runtime.repairs.findings("r1")
        )
        assert await changes_of(runtime) == []
        await runtime.robots.observe("r1", Batch(("active(altitude, high)",), source="rover"))
        # to say that one is active denies the others
        (change,) = await ended(runtime, 1)
        assert texts([change])[0][:2] == ("high", "low")
        entry = state.obs.get(Atom("active", ("altitude", "medium")))
        assert entry is not None
        assert not entry.positive


async def test_the_global_stop_stops_changes_as_well(tmp_path: Path) -> None:
    async with rover_of(tmp_path) as (runtime, rover):
        await runtime.repairs.stop(by="ada", reason="look")
        rover.visibility = 2.9
        state = await runtime.robots.memory.robot("r1")
        why = "the global stop is active"
        await eventually(lambda: state.function_states()["altitude"].held.endswith(why), why)
        assert await changes_of(runtime) == []
        await runtime.repairs.resume(by="ada", reason="go on")
        assert texts(await ended(runtime, 1)) == [("high", "medium", "changed")]
        rover.holds = True
        rover.visibility = 2.0

        async def acts() -> bool:
            return any(one["state"] == "running" for one in await changes_of(runtime))

        await until(acts, "the change to begin")
        await runtime.repairs.stop(by="ada", reason="look again")
        changes = await ended(runtime, 2)
        assert texts(changes[1:]) == [("medium", "low", "cancelled")]
        assert changes[1]["reason"] == "global stop: look again"
        rover.held.set()


async def test_what_the_acts_of_a_variant_stop_is_no_fault_while_it_is_active(tmp_path: Path) -> None:
    model = MODEL.replace("[localise(odometry)]", "[stop_node(lidar_node), localise(odometry)]")
    model = model.replace("lidar: {needs: [lidar_node]", 'lidar: {when: "ok(indoors)", needs: [lidar_node]')
    async with service(tmp_path) as runtime, rover_on(runtime, model, policy="auto") as rover:
        await runtime.robots.observe("r1", Batch(("ok(indoors)",), source="map"))
        await rover.settled()
        await runtime.robots.observe("r1", Batch(("not ok(indoors)",), source="map"))
        (change,) = await ended(runtime, 1)
        assert (change["state"], rover.driver) == ("changed", False)
        await rover.settled()
        state = await runtime.robots.memory.robot("r1")

        async def well() -> bool:
            await rover.settled()
            return str(health_of(state)[0]) == "healthy"

        await until(well, "the robot to be healthy without the node")
        await runtime.robots.observe("r1", Batch(("ok(indoors)",), source="map"))
        await ended(runtime, 2)
        assert rover.done == [
            "stop_node(lidar_node)", "localise(odometry)", "start_node(lidar_node)", "localise(lidar)",
        ]  # fmt: skip
        assert list(await runtime.repairs.repairs("r1", before=None, limit=5)) == []


@pytest.mark.parametrize("made", [False, True])
async def test_after_a_restart_what_was_cut_off_is_told_as_it_is_seen_and_undone_as_what_was_made(
    tmp_path: Path, made: bool
) -> None:
    async with rover_of(tmp_path) as (runtime, rover):
        rover.visibility = 2.9
        await ended(runtime, 1)
        rover.holds = True
        rover.visibility = 2.0

        await eventually(lambda: "set_mode(spiral, low)" in rover.begun, "the change")
    async with service(tmp_path) as runtime:
        again = Rover(runtime.repairs, runtime.robots)
        again.active, again.visibility = dict(rover.active), 2.0
        if made:
            again.active["altitude"] = "low"
        async with running(again):
            changes = await ended(runtime, 2 if made else 3)
            cut_off = [("medium", "low", "changed")] if made else [
                ("medium", "low", "failed"), ("medium", "low", "changed"),
            ]  # fmt: skip
            assert texts(changes) == [("high", "medium", "changed"), *cut_off]
            assert again.done == ([] if made else ["set_mode(spiral, low)"])
            again.visibility = 4.0
            changes = await ended(runtime, len(changes) + 1)
            back = [one["changes"][0]["back"] for one in changes if one["state"] == "changed"]
            assert [one is not None for one in back] == [True, True, False]
            assert await runtime.store.read(journal.unsettled, "r1") == ()
