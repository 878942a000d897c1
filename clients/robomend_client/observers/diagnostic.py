"""The diagnostic observer (DObs): ok(d) from the diagnostics that a device's driver publishes.

    status   name "hokuyo: connection", level 0, values {"temperature": "39.5"}
             └ matched by `status`      └ OK 0, WARN 1, ERROR 2, STALE 3
    rules    temperature < 40           → ok(temperature)
             motor: CPU 1 temp <= 60    → ok(motor), where the key is no good name

ok(d) iff no status that matches is as bad as `bad_from`; the worst of the newest ones counts. STALE says
that the publisher itself does not know: unknown, unless `stale: bad`. When nothing comes for `lifetime_s`,
d is unknown, unless `missing: bad`. After a reset a good verdict waits, at most for the settling time, for
all statuses that were heard before: the bad one may be the last to come.

A sample is one status or a list of them (diagnostic_msgs/DiagnosticArray's `status`), as mappings with
`name`, `level`, `values` (a mapping, or a list of `key` and `value`). Names are matched whole, as they are
but for `*` and `?` (`hokuyo: *`): the published observer took any name that contained the device's.

Source: the paper, section IV-B.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from operator import eq, ge, gt, le, lt, ne
from typing import Any, ClassVar, NamedTuple

from robomend_client.literals import Atom, Literal, parse_atom
from robomend_client.observers.base import SECOND, Evidence, WrongKind, finite
from robomend_client.observers.reading import Judgement, Readings
from robomend_client.readings import Reading, Symptom

DIAGNOSTICS = "diagnostics"
"""The source whose samples are diagnostic statuses."""

OK, WARN, ERROR, STALE = range(4)
SHOWN = ("OK", "WARN", "ERROR", "STALE")
LEVELS = {"warn": WARN, "error": ERROR}
MOST_STATUSES = 1000

RULE = re.compile(
    r"(?:(?P<name>[^:<>=!]+):)?(?P<key>[^<>=!]+?)\s*"
    r"(?:(?P<op><=|>=|==|!=|<|>)\s*(?P<limit>[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)"
    r"|(?P<is>==|!=)\s*(?P<text>[^\W\d][\w .-]*?))\s*\Z"
)
OPERATORS = {"<": lt, "<=": le, ">": gt, ">=": ge, "==": eq, "!=": ne}
NUMBER = re.compile(
    r"\s*(?:(?P<hex>[+-]?0[xX][0-9a-fA-F]+)(?!\w)"
    r"|(?P<comma>[+-]?\d+,(?:\d{1,2}|\d{4,})(?!\d))"
    r"|(?P<thousands>[+-]?\d{1,3}(?:,\d{3})+\.\d+|[+-]?\d{1,3}(?:,\d{3}){2,}(?!\d))"
    r"|(?!0[xXbBoO][0-9a-fA-F])(?P<plain>[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?))"
)
UNIT = re.compile(r"\s*(?:[^\w\s.,:/+-]*[^\W\d_]\D*[²³\d]?|%.*)?\Z|\s+[^\d\s].*\Z", re.DOTALL)


def number_of(text: str) -> float | None:
    """Return a number as people and programs write it, with or without a unit: `39.5 °C`, `39,5`, `0x1F`.

    None if it is none (`1.2.3`, `12:30`), or could be another one as well (`1,234`).
    """
    found = NUMBER.match(text)
    if found is None or not UNIT.match(text, found.end()):
        return None
    if found["hex"]:
        return float(int(found["hex"], 16))
    if found["comma"]:
        return float(found["comma"].replace(",", "."))
    if found["thousands"]:
        return float(found["thousands"].replace(",", ""))
    return float(found["plain"])


@dataclass(frozen=True)
class Levels:
    """Which levels are bad.

    Attributes:
        bad_from: the least level that is bad: `warn`, or `error`, where a warning is still ok.
        stale: what the level STALE means: `unknown` or `bad`.
        missing: what it means that no status comes for lifetime_s: `unknown` or `bad`.
    """

    bad_from: str = "warn"
    stale: str = "unknown"
    missing: str = "unknown"

    PRESETS: ClassVar[Mapping[str, Mapping[str, Any]]] = {
        "published": {"bad_from": "warn", "stale": "bad", "missing": "bad", "lifetime_s": 2.0}
    }

    def __post_init__(self) -> None:
        for name, allowed in (
            ("bad_from", tuple(LEVELS)),
            ("stale", ("unknown", "bad")),
            ("missing", ("unknown", "bad")),
        ):
            if getattr(self, name) not in allowed:
                raise ValueError(f"{name} must be one of {', '.join(allowed)}, not {getattr(self, name)!r}")


@dataclass(frozen=True)
class ValueRule:
    """A value that a status carries, and what it should be: a number, or a text in whatever case."""

    atom: Atom
    key: str
    op: str
    limit: float | str

    @classmethod
    def parse(cls, text: str) -> ValueRule:
        found = RULE.match(text)
        if found is None:
            raise ValueError(f"rules: {text!r} is no rule; write e.g. temp_cpu1 < 40, or brake == OK")
        key = found["key"].strip()
        atom = parse_atom((found["name"] or key).strip())
        if found["text"]:
            return cls(atom, key, found["is"], found["text"])
        return cls(atom, key, found["op"], float(found["limit"]))

    def read(self, value: object) -> float | str | None:
        """Return what is to be judged; None where the value is not of its kind."""
        if isinstance(self.limit, str):
            return str(value).strip() if isinstance(value, str | bool) and str(value).strip() else None
        return finite(number_of(value) if isinstance(value, str) else value)

    def allows(self, value: float | str) -> bool:
        """Return whether it is what it should be."""
        if isinstance(value, str):
            return (value.casefold() == str(self.limit).casefold()) == (self.op == "==")
        return bool(OPERATORS[self.op](value, self.limit))

    @property
    def shown(self) -> str:
        """What it should be, in words."""
        return f"{self.op} {self.limit}" if isinstance(self.limit, str) else f"{self.op} {self.limit:g}"


class DiagnosticObserver:
    """Watches the statuses of one device."""

    def __init__(
        self,
        atom: str,
        status: Sequence[str],
        rules: Sequence[str] = (),
        levels: Levels | None = None,
        readings: Readings | None = None,
        source: str = DIAGNOSTICS,
    ) -> None:
        """
        Args:
            atom: what the levels say, e.g. `ok(hokuyo)`; `hokuyo` is short for it; by default the entry's
                name.
            status: names or patterns, whole, of the statuses that speak of it, e.g. `hokuyo: *`.
            rules: on their values: `temperature < 40` says ok(temperature), `motor: CPU 1 temp <= 60` says
                ok(motor), `brake: Brake state == OK` says ok(brake).
            levels: which are bad.
            readings: how many make a verdict.
            source: where the statuses come from: any topic of DiagnosticArray (`diagnostics_agg`).
        """
        if not status:
            raise ValueError("status must name at least one status, e.g. 'hokuyo: *'")
        levels, readings = levels or Levels(), readings or Readings()
        self._patterns = tuple(_pattern(name.removeprefix("/")) for name in status)
        self._rules = tuple(ValueRule.parse(rule) for rule in rules)
        device = parse_atom(atom)
        self.atoms: tuple[Atom, ...] = tuple(dict.fromkeys((device, *(rule.atom for rule in self._rules))))
        # Of a topic of ROS the statuses are a field; whoever knows no fields delivers them by its name.
        self.sources = frozenset(
            (source,) if source == DIAGNOSTICS or ":" in source else (source, f"{source}:status")
        )
        self.period_ns = 0
        self.detection_s = readings.delay_s
        wait_s = readings.delay_s + readings.interval_s
        self.settling_s = max(wait_s, readings.lifetime_s if levels.missing == "bad" else 0.0)
        self._wait_ns = round(readings.interval_s * 1e9)
        self._device = device
        self._bad_from = LEVELS[levels.bad_from]
        self._stale_is_bad = levels.stale == "bad"
        self._missing_is_bad = levels.missing == "bad"
        self._lifetime_ns = round(readings.lifetime_s * 1e9)
        self._judgements: dict[Atom, Judgement] = {atom: readings.judgement() for atom in self.atoms}
        self._newest: dict[tuple[str, str, int], _Status] = {}
        self.reset(0)

    def reset(self, time_ns: int) -> None:
        # What was heard before, and is to be heard again before anything is good; for a while.
        self._awaited = set(self._newest)
        self._awaited_until_ns = time_ns + self._wait_ns
        self._newest = {}
        self._heard_ns = time_ns
        for judgement in self._judgements.values():
            judgement.reset()

    def feed(self, source: str, time_ns: int, value: object) -> None:
        if value is None and DIAGNOSTICS not in self.sources:
            return  # a message of a topic, whose field comes as well
        statuses = [value] if isinstance(value, Mapping) else value
        if not isinstance(statuses, Sequence) or isinstance(statuses, str | bytes):
            raise WrongKind("a diagnostic status or a list of them is", value)
        ours = [s for s in statuses if self._matches(str(s["name"]))]
        times: Counter[tuple[str, str]] = Counter()
        for status in ours:
            level = status["level"]
            level = level[0] if isinstance(level, bytes) else int(level)  # ROS 2 has a byte
            name = str(status["name"])
            of = name, str(status.get("hardware_id", ""))
            times[of] += 1
            key = *of, times[of]  # the same name may be there for each of several devices
            self._awaited.discard(key)
            if key in self._newest or len(self._newest) < MOST_STATUSES:
                message = str(status.get("message", ""))
                self._newest[key] = _Status(name, time_ns, level, message, self._rules_of(status))
        if ours:
            self._judge(time_ns)

    def due_ns(self) -> int | None:
        return min(self._times_ns(), default=None)

    def due_after(self, now_ns: int) -> int | None:
        return min((time_ns for time_ns in self._times_ns() if time_ns > now_ns), default=None)

    def check(self, now_ns: int) -> tuple[Literal, ...]:
        found = []
        for atom, judgement in self._judgements.items():
            good = judgement.at(now_ns)
            if atom == self._device and self._missing(now_ns):
                good = False
            if good is not None:
                found.append(Literal(atom, good))
        return tuple(found)

    def evidence(self, atom: Atom, now_ns: int) -> Evidence:
        judgement = self._judgements[atom]
        if atom == self._device and self._missing(now_ns):
            silent = Reading(
                f"no status for {(now_ns - self._heard_ns) / SECOND:.3g} s", symptom=Symptom.SILENT
            )
            return Evidence(now_ns - self._lifetime_ns, judgement.good_ns, silent)
        read = judgement.read
        assert isinstance(read, Reading)
        symptom = Symptom.SELF_REPORT if judgement.bad else None
        return judgement.evidence._replace(reading=read._replace(symptom=symptom))

    # --- inside ----------------------------------------------------------------------------------------

    def _matches(self, name: str) -> bool:
        name = name.removeprefix("/")
        return any(pattern.match(name) for pattern in self._patterns)

    def _times_ns(self) -> Iterator[int]:
        """Return when a verdict turns by itself: each when nothing speaks of it for its lifetime."""
        for judgement in self._judgements.values():
            due_ns = judgement.due_ns()
            if due_ns is not None:
                yield due_ns
        if self._missing_is_bad:
            yield self._heard_ns + self._lifetime_ns

    def _missing(self, now_ns: int) -> bool:
        return self._missing_is_bad and now_ns - self._heard_ns >= self._lifetime_ns

    def _judge(self, time_ns: int) -> None:
        """Judge by the newest of each status."""
        self._heard_ns = time_ns
        life_ns = self._lifetime_ns
        fresh = self._newest = {
            key: one for key, one in self._newest.items() if time_ns - one.time_ns < life_ns
        }
        judgement = self._judgements[self._device]
        bad = [one for one in fresh.values() if self._is_bad(one.level) or self._breaks(one)]
        good = [one for one in fresh.values() if one.level < self._bad_from]
        if bad:
            worst = max(bad, key=lambda one: (one.level, one.time_ns))
            judgement.add(time_ns, False, max(one.time_ns for one in bad), Reading(str(worst)))
        elif not good:
            judgement.reset()  # all of them are stale: the publisher does not know
        elif not self._waits(time_ns):
            judgement.add(time_ns, True, min(one.time_ns for one in good), Reading("OK"))
        for rule in dict.fromkeys(rule for one in fresh.values() for rule in one.rules):
            if rule.atom != self._device:
                self._judge_rule(rule, time_ns)

    def _judge_rule(self, rule: ValueRule, time_ns: int) -> None:
        told = [(one, one.rules[rule]) for one in self._newest.values() if rule in one.rules]
        if not any(one.time_ns == time_ns for one, _ in told):
            return  # nothing new
        limit = rule.shown
        broken = [(one, value) for one, value in told if not rule.allows(value)]
        if broken:
            newest, value = max(broken, key=lambda found: found[0].time_ns)
            self._judgements[rule.atom].add(time_ns, False, newest.time_ns, Reading(value, "", limit))
        elif not self._waits(time_ns):
            oldest = min(one.time_ns for one, _ in told)
            self._judgements[rule.atom].add(time_ns, True, oldest, Reading(told[-1][1], "", limit))

    def _waits(self, time_ns: int) -> bool:
        """Return whether one of those that were heard before the reset may still be bad."""
        return bool(self._awaited) and time_ns < self._awaited_until_ns

    def _breaks(self, status: _Status) -> bool:
        """Return whether a status breaks a rule on the device itself."""
        return any(
            rule.atom == self._device and not rule.allows(value) for rule, value in status.rules.items()
        )

    def _is_bad(self, level: int) -> bool:
        return self._stale_is_bad if level == STALE else level >= self._bad_from

    def _rules_of(self, status: Mapping[str, Any]) -> dict[ValueRule, float | str]:
        """Return the rules that a status speaks of, each with the value that is worst: keys may repeat."""
        values = (status.get("values") or {}) if self._rules else {}
        pairs = (
            list(values.items())
            if isinstance(values, Mapping)
            else [(pair["key"], pair["value"]) for pair in values]
        )
        found: dict[ValueRule, float | str] = {}
        for rule in self._rules:
            for key, value in pairs:
                read = rule.read(value) if key == rule.key else None
                if read is not None and (rule not in found or rule.allows(found[rule])):
                    found[rule] = read
        return found


def _pattern(name: str) -> re.Pattern[str]:
    """Return what matches a name as it is written; `*` is any text, `?` any character, `[*]` an asterisk."""
    parts = (
        re.escape(one[0][1]) if len(one[0]) > 1 else {"*": ".*", "?": "."}.get(one[0], re.escape(one[0]))
        for one in re.finditer(r"\[[*?[]\]|.", name, re.DOTALL)
    )
    return re.compile("".join(parts) + r"\Z", re.DOTALL)


class _Status(NamedTuple):
    """The newest of one name."""

    name: str
    time_ns: int
    level: int
    message: str
    rules: dict[ValueRule, float | str]

    def __str__(self) -> str:
        level = SHOWN[self.level] if 0 <= self.level < len(SHOWN) else f"level {self.level}"
        return f"{self.name}: {level} {self.message}".strip()
