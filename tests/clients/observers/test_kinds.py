"""Observers by name and from a file: the section `observers:`, your own, and the recipes of the manual."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable
from contextlib import suppress
from dataclasses import fields
from pathlib import Path
from textwrap import dedent

import pytest
from tests.distributions import install

from robomend_client.literals import Atom, parse_atom
from robomend_client.observers import (
    Answers,
    Band,
    BoardReadings,
    Driver,
    Filter,
    Levels,
    Match,
    Observer,
    Rate,
    Readings,
    Table,
    Trend,
    Wiring,
    ns,
)
from robomend_client.observers.kinds import KINDS, ObserverSpec, read_lenient, read_observers
from robomend_client.yaml_reader import ConfigError, read

ROOT = Path(__file__).parents[3]
MANUAL = (ROOT / "docs" / "observers.md").read_text()

EVERY_KIND = """\
observers:
  scan: {kind: general, rate_hz: 20, tolerance_hz: 2}
  hokuyo_node: {kind: node, lifetime_s: 1}
  hokuyo: {kind: diagnostic, status: ["hokuyo: *"], rules: [temperature < 40], lifetime_s: 3}
  map_triggered: {kind: multiple, in_topic: scan, out_topic: map, within_s: 0.2}
  yaw: {kind: qualitative, source: "odom:yaw", preset: published, slope: 0.1}
  "matched(a,b)": {kind: binary_qualitative, first: "odom:a", second: "imu:b", threshold: 5}
  board: {kind: hardware, wiring: {jaguar: {channel: 7, expected_current_a: 3}, imu: {channel: 1}}}
  "ok(CPU,laser)": {kind: property, source: "processes:CPU(laser)", high: 0.9, filter: median, agreeing: 3}
  "ok(goals,dock)": {kind: goals}
  "ok(log,camera)": {kind: rosout, ignore: ["timed out*again"]}
  "ok(lifecycle,camera)": {kind: lifecycle}
  "ok(moves,imu)": {kind: changing, source: "imu:z"}
  "ok(age,scan)": {kind: age}
  "ok(publishers,odom)": {kind: publishers}
  "ok(qos,scan)": {kind: qos}
  "ok(restarts,laser)": {kind: restarts, restarts: 2}
"""


def specs(tmp_path: Path, text: str) -> tuple[ObserverSpec, ...]:
    file = tmp_path / "agent.yaml"
    file.write_text(dedent(text))
    top = read(file)
    found = read_observers(top, tmp_path)
    top.finish()
    return found


def test_every_kind_is_made_from_a_file(tmp_path: Path) -> None:
    found = specs(tmp_path, EVERY_KIND)
    assert {spec.kind for spec in found} == set(KINDS.names())
    atoms = {str(atom) for spec in found for atom in spec.atoms}
    assert {
        "ok(scan)", "running(hokuyo_node)", "ok(hokuyo)", "ok(temperature)", "ok(map_triggered)", "inc(yaw)",
        "matched(a,b)", "on(jaguar)", "ok(current,jaguar)", "on(imu)", "ok(CPU,laser)", "ok(goals,dock)",
        "ok(log,camera)", "ok(lifecycle,camera)", "ok(moves,imu)", "ok(age,scan)", "ok(publishers,odom)",
        "ok(qos,scan)", "ok(restarts,laser)",
    } <= atoms  # fmt: skip
    assert all(isinstance(spec.make(), Observer) for spec in found)
    assert found[0].make() is not found[0].make()


def test_a_preset_has_the_published_numbers_and_a_key_beside_it_counts_more(tmp_path: Path) -> None:
    def made(observer: str) -> Observer:
        return specs(tmp_path, f"observers: {{x: {observer}}}")[0].make()

    assert made("{kind: qualitative, source: a, preset: published}").period_ns == 0
    assert made("{kind: general, preset: published}").detection_s == 2.5
    assert made("{kind: general, preset: published, silence_s: 3}").detection_s == 3.5
    assert made("{kind: diagnostic, status: [a], preset: published}").settling_s == 2


def test_no_kind_that_has_the_key_latched_passes_it_over(tmp_path: Path) -> None:
    heeds = {}
    for line in EVERY_KIND.splitlines()[1:]:
        with suppress(ConfigError):  # most do not have it
            (spec,) = specs(tmp_path, f"observers:\n{line[:-1]}, latched: true}}\n")
            heeds[spec.kind] = getattr(spec.make(), "latched", False)
    assert heeds.pop("diagnostic") is False  # its statuses are many: each counts for its lifetime
    assert heeds == dict.fromkeys(heeds, True) != {}


@pytest.mark.parametrize(
    ("entry", "value"),
    [
        ("{kind: property, source: x, high: 1}", 0.5),
        ('{kind: age, atom: "ok(x)", source: x}', 1_764_000_000.0),
    ],
)
def test_a_number_and_an_age_keep_what_a_latched_topic_said_over_a_reset(
    tmp_path: Path, entry: str, value: object
) -> None:
    (spec,) = specs(tmp_path, f"observers: {{x: {entry[:-1]}, latched: true}}}}")
    observer, now_ns = spec.make(), ns(1_764_000_000)
    observer.reset(now_ns)
    for _ in range(3):
        observer.feed("x", now_ns, value)
    observer.reset(now_ns + ns(60))
    assert [str(literal) for literal in observer.check(now_ns + ns(3600))] == ["ok(x)"]


@pytest.mark.parametrize(
    ("observer", "complaint"),
    [
        (
            "{kind: genral}",
            "x.kind: no kind of observer is named 'genral': choose one of general, node, .*did you",
        ),
        ("{rate_hz: 10}", "x.kind: is missing"),
        ("{kind: general, rat_hz: 10}", "x.rat_hz: is no key here; did you mean rate_hz?"),
        ("{kind: general, rate_hz: fast}", "x.rate_hz: must be a number"),
        ("{kind: general, rate_hz: 0}", "x.rate_hz: rate_hz must be above 0, not 0"),
        ("{kind: general, window: 2.5}", "x.window: must be a whole number"),
        ("{kind: general, preset: publshed}", "x.preset: must be one of published"),
        ("{kind: hardware, preset: published, wiring: {}}", "x.preset: this kind has none"),
        ("{kind: qualitative}", "x.source: is missing"),
        ("{kind: property, source: a}", "x.low: low or high is needed"),
        ("{kind: property, source: a, higg: 1}", "x.higg: is no key here; did you mean high?"),
        ("{kind: property, source: a, high: 1, filter: mode}", "x.filter: filter must be one of none, mean"),
        ("{kind: diagnostic, status: a}", "x.status: must be a list"),
        ("{kind: diagnostic, status: [a], rules: [hot]}", "x.rules: rules: 'hot' is no rule; write e.g."),
        ("{kind: hardware}", "x.wiring: is missing"),
        (
            "{kind: hardware, wiring: {a: {chanel: 1}}}",
            "x.wiring.a.chanel: is no key here; did you mean channel",
        ),
        ("{kind: multiple, in_topic: a, out_topic: a}", "x.out_topic: out_topic must be another topic"),
        ("{kind: property, atom: 'ok((', source: a, high: 1}", r"x: 'ok\(\(' is no atom"),
        ("{kind: goals, in_a_row: 0}", "x.in_a_row: in_a_row must be from 1"),
        ("{kind: rosout, level: info}", "x.level: level must be one of warn, error, fatal"),
        ("{kind: rosout, ignore: ['*']}", "x.ignore: ignore must name a part of a line"),
        ("{kind: lifecycle, state: running}", "x.state: state must be one of unconfigured"),
        ("{kind: changing, source: a, still_s: 0}", "x.still_s: still_s must be above 0"),
        ("{kind: publishers, least: 2}", "x.most: most must be from 2"),
        ("{kind: nowhere.py:A}", "x.kind: there is no file .*nowhere.py"),
        ("{kind: bad.py:A}", "x.kind: .*bad.py cannot be run: ZeroDivisionError"),
        ("{kind: good.py:B}", "x.kind: .*good.py has no class or function 'B'"),
        ("{kind: good.py:Untyped}", "x.kind: the parameter limit needs a type"),
        ("{kind: good.py:Odd, limit: 1}", "x.kind: limit has the type .*complex.*, which no file can hold"),
    ],
)
def test_each_mistake_is_named_with_its_place(tmp_path: Path, observer: str, complaint: str) -> None:
    (tmp_path / "bad.py").write_text("1 / 0\n")
    (tmp_path / "good.py").write_text(
        "class Untyped:\n    def __init__(self, limit): ...\n"
        "class Odd:\n    def __init__(self, atom: str, limit: complex): ...\n"
    )
    with pytest.raises(ConfigError, match=rf"agent.yaml:2: observers\.{complaint}"):
        specs(tmp_path, f"observers:\n  x: {observer}\n")


@pytest.mark.parametrize(
    ("kind", "wrong", "named"),
    [
        (Rate, {"rate_hz": 0.0}, "rate_hz"), (Rate, {"window": 1}, "window"),
        (Rate, {"window": 10, "settle": 10}, "settle"), (Rate, {"silence_s": 0.1}, "silence_s"),
        (Rate, {"check_s": -1.0}, "check_s"), (Rate, {"test": "guess"}, "test"),
        (Rate, {"significance": 1.0}, "significance"), (Rate, {"held_s": -1.0}, "held_s"),
        (Rate, {"lost": 0}, "lost"), (Rate, {"pause_s": 0.1}, "pause_s of 0.1 is no longer than one"),
        (Rate, {"tolerance_above_hz": 0}, "tolerance_above_hz"),
        (Levels, {"stale": "maybe"}, "stale must be one of"),
        (Answers, {"unasked": "no"}, "unasked"), (Answers, {"within_s": 0}, "within_s"),
        (Trend, {"window_s": 0.0}, "window_s"), (Trend, {"slope": -1.0}, "slope"),
        (Trend, {"hysteresis": 1.0}, "hysteresis"), (Trend, {"debounce_s": -1.0}, "debounce_s"),
        (Trend, {"wraps_at": 0.0}, "wraps_at"),
        (Match, {"tick_s": 0.0}, "tick_s"), (Match, {"window_s": 0.5}, "window_s"),
        (Match, {"second_slope": 0.0}, "second_slope"), (Match, {"compare": "trend"}, "compare"),
        (Match, {"derive": "second"}, "derive"), (Match, {"threshold": -1}, "threshold"),
        (Band, {"low": 2.0, "high": 1.0}, "low"), (Band, {"high": 1.0, "hysteresis": -1.0}, "hysteresis"),
        (Band, {"low": 0.0, "high": 1.0, "hysteresis": 0.6}, "hysteresis"),
        (Filter, {"filter_window": 0}, "filter_window"), (Filter, {"filter_decay": 0.0}, "filter_decay"),
    ],
)  # fmt: skip
def test_impossible_parameters_are_refused_by_name(
    kind: Callable[..., object], wrong: dict[str, object], named: str
) -> None:
    with pytest.raises(ValueError, match=rf"^{named} "):
        kind(**wrong)


def test_atoms_of_which_good_news_wins_are_a_list(tmp_path: Path) -> None:
    (tmp_path / "agent.yaml").write_text('lenient: [ok(scan), "ok(CPU,a)", odom]')
    assert read_lenient(read(tmp_path / "agent.yaml")) == {
        Atom("ok", ("scan",)),
        Atom("ok", ("CPU", "a")),
        Atom("ok", ("odom",)),
    }
    (tmp_path / "agent.yaml").write_text("lenient: [ok(]")
    with pytest.raises(ConfigError, match=r"agent.yaml:1: lenient: 'ok\(' is no atom"):
        read_lenient(read(tmp_path / "agent.yaml"))


@pytest.mark.parametrize(
    ("text", "atom"),
    [
        ("ok(scan)", Atom("ok", ("scan",))),
        (" ok ( CPU , node ) ", Atom("ok", ("CPU", "node"))),
        ("/scan", Atom("ok", ("scan",))),
        ('ok("a, b)")', Atom("ok", ("a, b)",))),
        ('"two words"', Atom("ok", ("two words",))),
    ],
)
def test_atoms_are_read_as_they_are_written(text: str, atom: Atom) -> None:
    assert parse_atom(text) == atom
    assert parse_atom(str(atom)) == atom


# --- your own ---------------------------------------------------------------------------------------------


def blocks(language: str, heading: str) -> list[str]:
    section = MANUAL.split(f"## {heading}\n")[1].split("\n## ")[0]
    return re.findall(rf"```{language}\n(.*?)```", section, re.DOTALL)


def said(spec: ObserverSpec, *values: object) -> list[str]:
    driver = Driver([spec.make()], 0)
    (source,) = spec.sources
    return [str(c.value) for k, v in enumerate(values) for c in driver.sample(source, ns(k), v, ns(k))]


def test_the_observers_of_the_manual_do_what_it_says(tmp_path: Path) -> None:
    for code in blocks("python", "Your own observer"):
        file = re.match(r"# (\w+\.py)", code)
        assert file is not None
        (tmp_path / file[1]).write_text(code)
        body = [line for line in code.splitlines() if line.strip() and not line.startswith(("#", "from"))]
        assert len(body) <= 10 or file[1] == "agree.py"  # the whole interface
    function, steady, agree = (
        spec for text in blocks("yaml", "Your own observer") for spec in specs(tmp_path, text)
    )
    assert function.sources == {"motor:temperature"}
    assert function.atoms == (Atom("ok", ("motor",)),)
    assert said(function, 65.0, 65.0, 65.0, 75.0, 75.0, 75.0) == ["ok(motor)", "not ok(motor)"]
    assert said(steady, 12.0, 12.2, 10.0, 10.1) == ["ok(voltage)", "not ok(voltage)", "ok(voltage)"]
    driver = Driver([agree.make()], 0)
    samples = [("left:speed", 1.0), ("right:speed", 1.1), ("left:speed", 2.0), ("right:speed", 2.1)]
    told = [c for k, (s, v) in enumerate(samples) for c in driver.sample(s, ns(k), v, ns(k))]
    assert [str(change.value) for change in told] == ["ok(wheels)", "not ok(wheels)", "ok(wheels)"]
    assert [change.since_ns for change in told] == [0, ns(1), ns(2)]
    assert [(change.value, change.time_ns >= ns(7)) for change in driver.advance(ns(9))] == [(None, True)]


def test_an_observer_of_another_distribution_is_found_by_its_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The package of the manual, installed by hand."""
    (entry,) = blocks("toml", "Your own observer")
    [module] = re.findall(r'^py-modules = \["(\w+)"\]$', entry, re.MULTILINE)
    [(group, points)] = re.findall(r'"(robomend\.observers)"\]\n(.*)', entry)
    kinds = dict(re.findall(rf'^(\w+) = "{module}:(\w+)"$', points, re.MULTILINE))
    code = blocks("python", "Your own observer")[1]
    site = install(tmp_path / "site", module, code, {group: kinds})
    monkeypatch.syspath_prepend(str(site))
    monkeypatch.delitem(sys.modules, module, raising=False)
    (spec,) = specs(tmp_path, 'observers: {v: {kind: steady, source: "battery:voltage", most: 1}}')
    assert said(spec, 1.0, 1.5) == ["ok(v)"]
    sys.modules.pop(module, None)


# --- the manual -------------------------------------------------------------------------------------------

KEYS = {
    "general": (Rate,),
    "node": (Table,),
    "diagnostic": (Levels,),
    "multiple": (Answers,),
    "qualitative": (Trend,),
    "binary_qualitative": (Match,),
    "hardware": (BoardReadings, Wiring),
    "property": (Band, Filter),
}


def row_of(section: str, key: str) -> str:
    """Return the line of the table that is about a key."""
    return next(line for line in section.splitlines() if re.match(rf"\|[^|]*`{key}`", line))


@pytest.mark.parametrize("kind", sorted(KEYS))
def test_the_manual_has_the_published_numbers(kind: str) -> None:
    published = {
        name: value
        for parameters in KEYS[kind]
        for name, value in getattr(parameters, "PRESETS", {}).get("published", {}).items()
        if value is not None
    }
    if not published:
        return
    (row,) = (line for line in MANUAL.splitlines() if line.startswith(f"| `{kind}` | `"))
    for name, value in published.items():
        shown = f"{value:g}".replace("e-07", "e-7") if isinstance(value, float | int) else str(value)
        assert f"`{name}` {shown}" in row


def test_the_manual_has_the_keys_of_readings() -> None:
    section = MANUAL.split("### Readings")[1].split("\n## ")[0]
    for field in fields(Readings):
        row = row_of(section, field.name)
        default = "false" if field.default is False else f"{field.default:g}"
        assert f"| {default} |" in row
