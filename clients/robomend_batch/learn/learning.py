"""From healthy logs to a draft: what is learned, in which order, and what of it is held against the rest."""

from __future__ import annotations

import math
import os
import tempfile
from collections import Counter
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

from robomend.errors import InputError
from robomend.model.from_graph import (
    Entries,
    FirstModel,
    comment,
    first_model,
    observers_lines,
    seconds_told,
    spoken_topics,
)
from robomend.model.loading import load_text
from robomend_batch.learn import draft
from robomend_batch.learn.delays import learn_delays
from robomend_batch.learn.gathering import (
    DIAGNOSTICS,
    NO_GRAPH,
    Gathered,
    Series,
    first_s,
    gather,
    heard_of,
    open_log,
)
from robomend_batch.learn.matches import learn_matches
from robomend_batch.learn.ranges import TELEMETRY, StatusFound, learn_range, learn_status
from robomend_batch.learn.rates import WAYS, RateFound, learn_rate
from robomend_batch.learn.stretches import Stretch, hours
from robomend_batch.logs.wanted import Wants
from robomend_batch.observing import Observing, load_observers
from robomend_batch.problems import Problems
from robomend_client.counts import counted
from robomend_client.literals import Atom
from robomend_client.observers.combining import Change
from robomend_client.observers.driver import Driver
from robomend_client.ros_graph import Heard, RosGraph

PER_HOUR = 0.1
"""False alarms of all observers together that are aimed at, where nobody says otherwise."""

TELEMETRY_SHARE = 0.1
"""False alarms of the ranges of telemetry, on top of those of all others."""

FOLDS = 5
"""So many times it is learned from other logs than it is tried on, at most."""

DOUBTFUL = 0.05
"""As many false alarms as were counted, or more, come about by chance less often: then it is said."""


@dataclass(frozen=True, slots=True)
class LearnedDraft:
    """What came out."""

    model: str
    observers: str
    entries: Entries
    logs: int
    learned_h: float
    held_back_h: float
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
    per_hour: float = PER_HOUR,
    live: RosGraph = NO_GRAPH,
    update: Path | None = None,
    on_log: Callable[[str], None] = lambda name: None,
) -> LearnedDraft:
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
    heard = replace(heard_of(found, live), statuses={}, origin={})  # what is learned of these says more
    again = partial(draft_of, found, heard, live, per_hour, robot)
    first = again()
    load_text(first.text)  # whatever the names in the logs are, what is drafted can be read
    entries = first.entries
    alarms = _trial(found, entries, found.held_back)
    held_back_h = hours(found.held_back)
    each = per_hour / max(1, len(entries.names))
    doubtful = tuple(
        name for name in entries.names if _by_chance(alarms[name], each * held_back_h) < DOUBTFUL
    )
    _doubt(found, entries, lambda without: again(without).entries, doubtful, alarms)
    head = _head(robot, heard.source, found, learned_h, per_hour, entries, sum(alarms.values()))
    for name in entries.names if found.held_back else ():
        told = f"held back: {counted(alarms[name], 'false alarm')} in {held_back_h:.3g} h"
        entries.evidence[name].append(told)
    return LearnedDraft(
        first.text,
        "\n".join([*(f"# {comment(line)}" for line in head), "", *observers_lines(entries), ""]),
        entries,
        len(found.names),
        learned_h,
        held_back_h,
        dict(alarms),
        tuple(entries.doubtful),
        found.problems.json(),
        {} if update is None else _contradicted(found, update),
    )


def draft_of(
    found: Gathered,
    heard: Heard,
    live: RosGraph,
    per_hour: float,
    robot: str,
    without: Collection[int] | None = None,
) -> FirstModel:
    """Return what is drafted of logs.

    Args:
        heard: of them.
        live: of the running robot, whose nodes are known to listen to what they listen to.
        per_hour: false alarms of all observers.
        without: logs that are held back, and nothing else; None: the stretches that are.
    """
    found = found if without is None else found.without(without)
    learned_h, learned = hours(found.learned), found.learned
    node_of = {topic.removeprefix("/"): node for topic, node in spoken_topics(heard.graph).items()}
    topics = sorted(node_of.keys() & found.topics.keys())
    pieces = {name: found.topics[name].pieces(learned) for name in topics}
    series: dict[str, Series] = {}
    for name in topics:
        series |= {f"{name}:{path}": one for path, one in found.topics[name].fields.items() if one.count}
    # The shares depend on how many observers there are: so delays are learned twice.
    unnamed = frozenset(name for name in topics if node_of[name] in heard.unnamed)
    delays, _ = learn_delays(pieces, node_of, learned_h, per_hour, unnamed)
    telemetry = [
        source for source in sorted(series) if found.topics[source.split(":", 1)[0]].types <= TELEMETRY
    ]
    ways = WAYS * len(topics) + len(delays) + 2 * len(found.statuses)
    share = per_hour / max(1, ways)
    more = TELEMETRY_SHARE * per_hour / max(1, 2 * len(telemetry))
    delays, together = learn_delays(pieces, node_of, learned_h, share, unnamed)
    rates = {name: learn_rate(name, pieces[name], learned_h, share) for name in topics}
    signs = draft.LearnedSigns(node_of, frozenset(found.nodes))
    signs.left_out += [(name, why) for name, why in rates.items() if isinstance(why, str)]
    answers: dict[str, dict[str, str]] = {}
    for delay in delays:
        rate = rates[delay.out_topic]
        signs.delay(delay, rate.silence_s if isinstance(rate, RateFound) else 0.0)
        if node_of[delay.out_topic] not in live.nodes:
            told = f"comes {seconds_told(delay.usual_s)} after {{}} (intervals alike by {delay.likeness:.2f})"
            answers[f"/{delay.out_topic}"] = {
                f"/{given}": told.format(given) for given in (delay.in_topic, *delay.more)
            }
    for match in learn_matches(series, node_of, learned):
        signs.match(match)
    for source in telemetry:
        rate = rates[source.split(":", 1)[0]]
        value = learn_range(source, series[source], learned, learned_h, more, telemetry=True)
        if isinstance(value, str):
            signs.left_out.append((source, value))
        elif isinstance(rate, RateFound):
            signs.range(value, rate.rate_hz)
    for (topic, name), one in sorted(found.statuses.items()):
        status = learn_status(name, one, learned, learned_h, share)
        if isinstance(status, StatusFound):
            signs.status(status, topic)
        else:
            signs.left_out.append((f"diagnostics of {name}", status))
    steady = {
        f"/{name}": rate
        if isinstance(rate, str)
        else draft.steady_topic(rate, first_s(found, name), len(found.spans_ns))
        for name, rate in rates.items()
    }
    graph = heard.graph
    listeners = dict(graph.subscribers)
    for out, inputs in answers.items():
        for given in inputs:
            listeners[given] = listeners.get(given, frozenset()) | graph.publishers[out]
    blamed = frozenset(f"/{node}" for node in signs.blamed.values())
    speakers = graph.publishers.get(f"/{DIAGNOSTICS}", frozenset()) | blamed
    remarks = [
        f"{first} and {other} are sent within a moment: perhaps by one node" for first, other in together
    ]
    heard = replace(
        heard,
        graph=replace(
            graph, publishers={**graph.publishers, f"/{DIAGNOSTICS}": speakers}, subscribers=listeners
        ),
        learned=signs.learned(steady, answers),
        remarks=(*heard.remarks, *remarks),
    )
    return first_model(heard, robot)


def _doubt(
    found: Gathered,
    entries: Entries,
    again: Callable[[Collection[int]], Entries],
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
    calm(found, entries, again)


def calm(found: Gathered, entries: Entries, again: Callable[[Collection[int]], Entries]) -> None:
    """See to it that observers call nothing of the logs false that they were made from: those that do are
    taken as they are learned from all of them, and left as comments if they do even then.
    """
    own = _trial(found, entries, found.whole)
    others = again(()) if own else Entries()
    for name in own:
        entries.take(name, others)
    for name, count in _trial(found, entries, found.whole).items() if own else ():
        entries.doubt(name, f"{counted(count, 'false alarm')} in the logs that it was learned from")


def _left_out(found: Gathered, entries: Entries, again: Callable[[Collection[int]], Entries]) -> Counter[str]:
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


def _trial(found: Gathered, entries: Entries, stretches: Sequence[Stretch]) -> Counter[str]:
    """Return the false alarms of each entry over stretches of the logs."""
    alarms: Counter[str] = Counter()
    if not stretches or not entries.names:
        return alarms
    handle, name = tempfile.mkstemp(suffix=".yaml", prefix="robomend-learn-")
    file = Path(name)
    try:
        with os.fdopen(handle, "w", encoding="utf-8") as stream:
            stream.write("\n".join(observers_lines(entries)))
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


def _head(
    robot: str,
    source: str,
    found: Gathered,
    learned_h: float,
    per_hour: float,
    entries: Entries,
    alarms: int,
) -> list[str]:
    held_back_h = hours(found.held_back)
    measured = (
        f"Measured over what was held back: {counted(alarms, 'false alarm')} in {held_back_h:.3g} h."
        if found.held_back
        else "Not measured: the logs are too short to hold any of them back."
    )
    return [
        f"Observers of {robot}, learned from {source}.",
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
