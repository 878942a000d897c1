"""From healthy logs to a draft: what is learned, in which order, and what of it is held against the rest."""

from __future__ import annotations

import math
import os
import tempfile
from collections import Counter
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

from robomend.errors import InputError
from robomend.model.from_graph import is_plumbing, is_tool, slug
from robomend.model.loading import load_text
from robomend_batch.learn import draft, model
from robomend_batch.learn.delays import DelayFound, learn_delays
from robomend_batch.learn.gathering import UNNAMED, Gathered, Series, first_s, gather, open_log
from robomend_batch.learn.matches import learn_matches
from robomend_batch.learn.ranges import TELEMETRY, RangeFound, StatusFound, learn_range, learn_status
from robomend_batch.learn.rates import WAYS, RateFound, learn_rate
from robomend_batch.learn.stretches import Stretch, hours
from robomend_batch.logs.wanted import Wants
from robomend_batch.observing import Observing, load_observers
from robomend_batch.problems import Problems
from robomend_client.counts import counted
from robomend_client.literals import Atom
from robomend_client.observers.combining import Change
from robomend_client.observers.driver import Driver
from robomend_client.ros_graph import RosGraph

NO_GRAPH = RosGraph()

TELEMETRY_SHARE = 0.1
"""False alarms of the ranges of telemetry, on top of those of all others."""

FOLDS = 5
"""So many times it is learned from other logs than it is tried on, at most."""

DOUBTFUL = 0.05
"""As many false alarms as were counted, or more, come about by chance less often: then it is said."""


@dataclass(frozen=True, slots=True)
class Learned:
    """What came out."""

    model: str
    observers: str
    entries: draft.Entries
    logs: int
    learned_h: float
    held_back_h: float
    meant_per_hour: float
    alarms: Mapping[str, int]  # entry -> false alarms over what was held back
    doubtful: tuple[str, ...]  # entries with more of them than was meant, or with any in their own logs
    problems: list[dict[str, object]]
    contradicted: Mapping[str, int] = field(default_factory=dict)  # entry of `update` -> false alarms

    @property
    def false_alarms(self) -> int:
        """Over what was held back."""
        return sum(self.alarms.values())


def learn(
    names: Sequence[str],
    *,
    robot: str = "robot",
    per_hour: float = 0.1,
    live: RosGraph = NO_GRAPH,
    update: Path | None = None,
    on_log: Callable[[str], None] = lambda name: None,
) -> Learned:
    """Learn from logs of a healthy robot.

    Args:
        names: of the logs.
        robot: the model's name.
        per_hour: false alarms of all observers together that are aimed at.
        live: who publishes and listens on the running robot: of topics that the logs name nobody for.
        update: a file whose observers are held against the logs.
        on_log: told of each log that was read.

    Raises:
        InputError: nothing can be learned from them.
    """
    found = gather(names, on_log)
    if not found.spans_ns:
        reasons = "; ".join(f"{p['place']}: {p['reason']}" for p in found.problems.json())
        raise InputError(f"there is nothing to learn from: {reasons}")
    learned_h = hours(found.learned)
    if not found.held_back:
        found.problems.add("", "too short to hold any of it back: no false alarms are measured", bad=False)
    entries = draft.Entries()
    publishers = model.publishers_of(found.topics.values(), live)
    single = {topic: next(iter(nodes)) for topic, nodes in publishers.items() if len(nodes) == 1}
    parts = _Parts(found, single, learned_h, per_hour, live)
    declared = model.Declared()
    text = model.draft_model(robot, _source(found), found.topics, publishers, parts.links, declared)
    known = model.declared_topics(text)
    parts.observe(entries, declared, known)
    text = model.draft_model(robot, _source(found), found.topics, publishers, parts.links, declared)
    load_text(text)  # whatever the names in the logs are, what is drafted can be read
    alarms = _trial(found, entries, found.held_back)
    held_back_h = hours(found.held_back)
    each = per_hour / max(1, len(entries.names))
    doubtful = tuple(
        name for name in entries.names if _by_chance(alarms[name], each * held_back_h) < DOUBTFUL
    )
    _doubt(found, entries, partial(parts.again, known), doubtful, alarms)
    head = _head(robot, found, learned_h, held_back_h, per_hour, entries, sum(alarms.values()))
    trial = {
        name: f"held back: {counted(alarms[name], 'false alarm')} in {held_back_h:.3g} h"
        for name in entries.names
        if found.held_back
    }
    return Learned(
        text,
        draft.observers_text(entries, head, trial),
        entries,
        len(found.names),
        learned_h,
        held_back_h,
        per_hour,
        dict(alarms),
        tuple(entries.doubtful),
        found.problems.json(),
        {} if update is None else _contradicted(found, update),
    )


class _Parts:
    """What each way of learning finds, with its share of the false alarms."""

    def __init__(
        self, found: Gathered, node_of: Mapping[str, str], learned_h: float, per_hour: float, live: RosGraph
    ) -> None:
        self._found = found
        self._live = live
        self._node_of = node_of
        self._per_hour = per_hour
        learned = found.learned
        topics = [
            name
            for name in sorted(found.topics)
            if name in node_of and not is_plumbing(f"/{name}") and not is_tool(node_of[name])
        ]
        pieces = {name: found.topics[name].pieces(learned) for name in topics}
        series: dict[str, Series] = {}
        for name in topics:
            series |= {f"{name}:{path}": one for path, one in found.topics[name].fields.items() if one.count}
        self.matches = learn_matches(series, node_of, learned)
        # The shares depend on how many observers there are: so delays are learned twice.
        unnamed = frozenset(name for name in topics if node_of[name].startswith(UNNAMED))
        self.delays: list[DelayFound]
        self.delays, _ = learn_delays(pieces, node_of, learned_h, per_hour, unnamed)
        telemetry = [
            source for source in sorted(series) if found.topics[source.split(":", 1)[0]].types <= TELEMETRY
        ]
        ways = WAYS * len(topics) + len(self.delays) + 2 * len(found.statuses)
        share = per_hour / max(1, ways)
        more = TELEMETRY_SHARE * per_hour / max(1, 2 * len(telemetry))
        self.delays, self.together = learn_delays(pieces, node_of, learned_h, share, unnamed)
        self.rates = {name: learn_rate(name, pieces[name], learned_h, share) for name in topics}
        self.ranges = {
            source: learn_range(source, series[source], learned, learned_h, more, telemetry=True)
            for source in telemetry
        }
        self.statuses = {
            (topic, name): learn_status(name, status, learned, learned_h, share)
            for (topic, name), status in sorted(found.statuses.items())
        }

    @property
    def links(self) -> model.Links:
        """What the topics have to do with each other."""
        return model.Links(self.delays, self.together, self._live, self._found.nodes)

    def again(self, known: frozenset[str], without: Collection[int] = ()) -> draft.Entries:
        """Return what is learned once more, with these logs held back and nothing else."""
        found = self._found.without(without)
        parts = _Parts(found, self._node_of, hours(found.learned), self._per_hour, self._live)
        again = draft.Entries()
        parts.observe(again, model.Declared(), known)
        return again

    def observe(self, entries: draft.Entries, declared: model.Declared, known: frozenset[str]) -> None:
        """Add the entries of all that was found, and what the model must declare for them.

        Args:
            entries: are added to.
            declared: is added to.
            known: topics that the model speaks of.
        """
        for name, found in self.rates.items():
            if name not in known:
                entries.left_out.append((name, "the model does not speak of it"))
            elif isinstance(found, RateFound):
                draft.rate_entry(entries, found, first_s(self._found, name))
            else:
                entries.left_out.append((name, found))
        taken = {*known, *(node.strip("/") for node in self._node_of.values())}
        for delay in self.delays:
            if delay.out_topic in known and delay.in_topic in known:
                name = slug(f"{delay.out_topic}_triggered", taken)
                taken.add(name)
                declared.properties[name] = self._node_of[delay.out_topic]
                rate = self.rates.get(delay.out_topic)
                silence_s = rate.silence_s if isinstance(rate, RateFound) else 0.0
                draft.delay_entry(entries, delay, name, silence_s)
        for match in self.matches:
            if not {source.split(":", 1)[0] for source in (match.first, match.second)} <= known:
                continue
            values = [self._value(source, declared, taken) for source in (match.first, match.second)]
            declared.related.append((values[0], values[1]))
            draft.match_entry(entries, match, str(Atom("matched", tuple(values))))
        for source, value in self.ranges.items():
            rate = self.rates[source.split(":", 1)[0]]
            if isinstance(value, str):
                entries.left_out.append((source, value))
            elif source.split(":", 1)[0] in known and isinstance(rate, RateFound):
                self._range(entries, declared, taken, value, rate.rate_hz)
        for (topic, name), status in self.statuses.items():
            if isinstance(status, StatusFound):
                self._status(entries, declared, taken, status, topic)
            else:
                entries.left_out.append((f"diagnostics of {name}", status))

    @staticmethod
    def _value(source: str, declared: model.Declared, taken: set[str]) -> str:
        topic, path = source.split(":", 1)
        for name, known in declared.values.items():
            if known == (topic, path):
                return name
        name = slug(f"{topic}_{path}", taken)
        taken.add(name)
        declared.values[name] = (topic, path)
        return name

    def _range(
        self,
        entries: draft.Entries,
        declared: model.Declared,
        taken: set[str],
        value: RangeFound,
        rate_hz: float,
    ) -> None:
        name = slug(f"{value.key}_range", taken)
        taken.add(name)
        declared.properties[name] = self._node_of[value.key.split(":", 1)[0]]
        draft.value_entry(entries, value, name, rate_hz)

    def _status(
        self,
        entries: draft.Entries,
        declared: model.Declared,
        taken: set[str],
        status: StatusFound,
        topic: str,
    ) -> None:
        blamed = _to_blame(status, {*self._node_of.values(), *self._found.nodes}, topic)
        if is_tool(blamed):
            entries.left_out.append((f"diagnostics of {status.name}", "it speaks of a tool"))
            return
        name = slug(f"{topic.rpartition('/')[0]} {status.name}".strip(), taken)
        taken.add(name)
        declared.properties[name] = blamed
        limits = {}
        for one in status.ranges:
            if any(letter in one.key for letter in "<>=!"):
                continue
            for sign, edge, ending in ((1, one.high, "max"), (-1, one.low, "min")):
                if edge is not None:
                    atom = slug(f"{name}_{one.key}_{ending}", taken)
                    taken.add(atom)
                    declared.properties[atom] = blamed
                    limits[atom] = (one.key, sign, one)
        draft.status_entry(entries, status, name, limits, topic)


def _to_blame(status: StatusFound, nodes: Collection[str], topic: str) -> str:
    """Return the node that a status speaks of: what its name begins with, as diagnostic_updater has it, in
    the namespace of its topic or publisher if several are called so; else its publisher.
    """
    space = f"/{topic}".rpartition("/")[0]
    named = status.name.split(":")[0].strip().strip("/")
    alike = [node for node in nodes if node.strip("/") == named]
    alike = alike or [node for node in nodes if node.rpartition("/")[2] == named]
    if space:
        alike = [node for node in alike if node.startswith(f"{space}/")] or alike
    only = status.publishers[0] if len(status.publishers) == 1 else None
    if len(alike) > 1 and only is not None:
        alike = [node for node in alike if node.rpartition("/")[0] == only.rpartition("/")[0]]
    if len(alike) == 1:
        return alike[0]
    return only or f"{space}/{slug(named)}"


def _doubt(
    found: Gathered,
    entries: draft.Entries,
    again: Callable[..., draft.Entries],
    doubtful: Sequence[str],
    alarms: Mapping[str, int],
) -> None:
    """See to it that what is drafted calls nothing false in its own logs.

    What does is learned again, with what was held back. Left as a comment is what does so even then, or did
    so more often over what was held back than was meant; and what calls something of a log false that was
    learned from the others alone: it would of the next log, too.
    """
    for name in doubtful:
        entries.doubt(
            name, f"{counted(alarms[name], 'false alarm')} over what was held back: more than was meant"
        )
    for name, count in _left_out(found, entries, again).items():
        entries.doubt(name, f"{counted(count, 'false alarm')} in logs when learned from the others alone")
    own = _trial(found, entries, found.whole)
    if not own:
        return
    others = again()
    for name in own:
        entries.take(name, others)
    for name, count in _trial(found, entries, found.whole).items():
        entries.doubt(name, f"{counted(count, 'false alarm')} in the logs that it was learned from")


def _left_out(found: Gathered, entries: draft.Entries, again: Callable[..., draft.Entries]) -> Counter[str]:
    """Return the false alarms of each entry over each log, learned from the others: all at once are FOLDS."""
    alarms: Counter[str] = Counter()
    folds = min(FOLDS, len(found.names))
    for fold in range(folds if folds > 1 else 0):
        logs = range(fold, len(found.names), folds)
        learned = again(logs)
        for section, kept in ((learned.topics, entries.topics), (learned.observers, entries.observers)):
            for name in section.keys() - kept.keys():  # it is not in the draft
                del section[name]
        alarms += _trial(found, learned, [stretch for stretch in found.whole if stretch.log in logs])
    return alarms


def _trial(found: Gathered, entries: draft.Entries, stretches: Sequence[Stretch]) -> Counter[str]:
    """Return the false alarms of each entry over stretches of the logs."""
    alarms: Counter[str] = Counter()
    if not stretches or not entries.names:
        return alarms
    handle, name = tempfile.mkstemp(suffix=".yaml", prefix="robomend-learn-")
    file = Path(name)
    try:
        with os.fdopen(handle, "w", encoding="utf-8") as stream:
            stream.write(draft.observers_text(entries, [], {}))
        return _alarms(found, file, stretches)
    finally:
        file.unlink()


def _contradicted(found: Gathered, file: Path) -> Mapping[str, int]:
    """Return the entries of a file that call something of healthy logs false, and how often."""
    try:
        return _alarms(found, file, found.whole)
    except InputError:  # it has no observers yet
        return {}


def _alarms(found: Gathered, file: Path, stretches: Sequence[Stretch]) -> Counter[str]:
    """Return the false alarms of each entry of a file over stretches of the logs."""
    observing = load_observers(file)
    alarms: Counter[str] = Counter()
    of_atom: dict[Atom, str] = {}
    for spec in observing.specs:
        of_atom |= dict.fromkeys(spec.atoms, spec.name)
    for atom, count in false_alarms(observing, found.names, stretches).items():
        alarms[of_atom[atom]] += count
    return alarms


def _by_chance(count: int, meant: float) -> float:
    """Return the probability of so many events or more where `meant` are expected (Poisson)."""
    return 1 - sum(math.exp(-meant) * meant**k / math.factorial(k) for k in range(min(count, 100)))


def _source(found: Gathered) -> str:
    names = ", ".join(Path(name).name for name in found.names[:3])
    more = f" and {len(found.names) - 3} more" if len(found.names) > 3 else ""
    return f"{counted(len(found.names), 'log')} of a healthy robot: {names}{more}"


def _head(
    robot: str,
    found: Gathered,
    learned_h: float,
    held_back_h: float,
    per_hour: float,
    entries: draft.Entries,
    alarms: int,
) -> list[str]:
    measured = (
        f"Measured over what was held back: {counted(alarms, 'false alarm')} in {held_back_h:.3g} h."
        if found.held_back
        else "Not measured: the logs are too short to hold any of them back."
    )
    return [
        f"Observers of {robot}, learned from {_source(found)}.",
        f"{learned_h:.3g} h were learned from, {held_back_h:.3g} h held back.",
        f"Meant: at most {per_hour:g} false alarms an hour of all {len(entries.names)} observers together.",
        measured,
        "Beside each number is what it rests on. Beyond what was seen, tails are taken to fall by a power.",
    ]


# --- the drafted observers over what was held back: by the same reader and driver as `robomend-batch run`.
#
# Whatever turns false there is a false alarm, for the robot was healthy.


def false_alarms(observing: Observing, names: Sequence[str], stretches: Sequence[Stretch]) -> Counter[Atom]:
    """Return how often each atom turned false in stretches of the logs, each of which is judged by itself."""
    found: Counter[Atom] = Counter()
    for log in sorted({stretch.log for stretch in stretches}):
        mine = [stretch for stretch in stretches if stretch.log == log]
        found += _of_log(observing, Path(names[log]), mine)
    return found


def _of_log(observing: Observing, path: Path, stretches: Sequence[Stretch]) -> Counter[Atom]:
    found: Counter[Atom] = Counter()

    def count(changes: Sequence[Change]) -> None:
        found.update(c.atom for c in changes if c.value is not None and not c.value.positive)

    with open_log(path) as recording:
        wants = Wants(recording.channels, observing.specs, path, Problems(), False, observing.names)
        drivers = [
            Driver([spec.make() for spec in wants.specs], stretch.start_ns, lenient=observing.lenient)
            for stretch in stretches
        ]
        here = 0
        for time_ns, number, data in recording.messages(wants.channels):
            while here + 1 < len(stretches) and time_ns >= stretches[here + 1].start_ns:
                here += 1
            if not stretches[here].start_ns <= time_ns < stretches[here].end_ns:
                continue
            for source, extract in wants.of[number]:
                try:
                    value = None if extract is None or data is None else extract(data)
                except Exception:  # noqa: BLE001  # damaged bytes raise whatever: counted when they were gathered
                    continue
                count(drivers[here].sample(source, time_ns, value))
        for driver, stretch in zip(drivers, stretches, strict=True):
            count(driver.advance(stretch.end_ns - 1))
    return found
