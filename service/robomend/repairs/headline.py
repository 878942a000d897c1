"""What people are told of a robot in two sentences, the same in lists, pages, commands, messages and events.

    what    what is wrong, since when, and what follows from it
    then    what happens next, or what a person is needed for

    "hokuyo has no power since 23:23:04; scan and 4 more follow."  "Power up hokuyo and restart hokuyo_node?"

`headline` is pure. `of_robot` asks it of a robot as it is now, `of_repair` of a repair as it is written. A
sentence is kept as its words and its moments, as whoever shows it knows which day it is.

A diagnosis is told fault by fault. Each fault is shown by the first symptom that a conflict with its
component rests on; what no conflict needs follows from the others. Belief is one number for a fault: the
share of its component among those that could stand in its place.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from typing import Any, NamedTuple

from robomend.entry import Entry
from robomend.model.functions import spoken_of
from robomend.model.vocabulary import ACTIVE
from robomend.planning.plan import action_titles, in_prose
from robomend.repairs.states import RepairState, StepState
from robomend.robots.clock import CLOCK
from robomend.robots.health import UNCLEAR, HealthState, health_of
from robomend.robots.robot import Robot
from robomend_client.counts import counted, first_few, listed
from robomend_client.literals import Atom, parse_atom
from robomend_client.readings import Symptom

Json = Mapping[str, Any]

Told = tuple[str | int, ...]
"""A sentence: its words, and its moments in nanoseconds since the epoch."""

CERTAIN, LIKELY = 0.9, 2 / 3
"""From these shares on a cause is told as almost certain, and as probable."""

MANY = 3
"""Names, actions or faults in a sentence; of more the number is told."""

Weighed = tuple[tuple[str, ...], float | None]
"""What a diagnosis blames, and its weight where there is one."""

LETTERS = 160
"""Of a reason or a reading in a headline; all of it is in the record."""

NONE_LEFT = "has no variant left"

NUMBERS = ("none", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine", "ten")


@dataclass(frozen=True, slots=True)
class Headline:
    """See the module."""

    what: Told
    then: Told
    person: bool = False  # a person is needed
    approve: str | None = None  # the repair whose plan waits for a yes
    since_ns: int | None = None

    def text(self, now_ns: int) -> str:
        """Return both sentences in one line, moments by the clock in UTC."""
        return " ".join(filter(None, (told(self.what, now_ns), told(self.then, now_ns))))


class Fallback(NamedTuple):
    """A function that works by another variant than its best one, or by none."""

    function: str
    variant: str | None  # None: none is left
    since_ns: int | None
    why: str  # not by a better one
    doubt: str = ""  # why it is not known to work by this one
    works: bool = True  # False: this one is active, and cannot do it


@dataclass(frozen=True, slots=True)
class Facts:
    """What a headline is made of."""

    health: HealthState
    blamed: Sequence[Weighed] = ()  # each diagnosis with its weight, best first
    more: int = 0  # diagnoses that are not among them
    symptoms: Sequence[Json] = ()  # `seen`, the oldest first
    unknown: Sequence[str] = ()
    waiting: bool = False  # it is reported bad, and waits for itself in a circle of topics
    away: Sequence[str] = ()  # observers of which nothing is left but what is unknown
    since_ns: int | None = None  # of the state, where no symptom says it
    fault: str = ""  # why there is no diagnosis
    reported: bool = True  # anything, ever
    judged: bool = True  # a repair that has just begun has written no diagnosis yet
    policy: str = "approve"
    repair: Json | None = None  # the newest, as HTTP shows it
    functions: Sequence[Fallback] = ()  # those that do not work by their best variant
    starved: Sequence[tuple[str, int]] = ()  # agents whose computer is starved, and since when


def told(words: Told, now_ns: int) -> str:
    """Return a sentence as text, moments by the clock in UTC; of another day with the date."""
    return "".join(each if isinstance(each, str) else clock(each, now_ns) for each in words)


def clock(time_ns: int, now_ns: int) -> str:
    """Return a moment by the clock, in UTC; of another day than now with the date."""
    moment = datetime.fromtimestamp(time_ns // 1_000_000 / 1000, UTC)
    same_day = moment.date() == datetime.fromtimestamp(now_ns // 1_000_000 / 1000, UTC).date()
    return f"{moment:%H:%M:%S}" if same_day else f"{moment:%Y-%m-%d %H:%M:%S}"


def seen(entry: Entry, conflicts: Iterable[tuple[Collection[str], Collection[str]]]) -> dict[str, Any]:
    """Return what does not hold, and the components of conflicts that rest on it: none, if it only follows.

    Args:
        conflicts: components and observations of each.
    """
    literal = str(entry.literal)
    blames = sorted({name for names, rests_on in conflicts if literal in rests_on for name in names})
    found = {
        "literal": literal,
        "since_ns": entry.since_ns,
        "onset_ns": entry.onset_ns,
        "blames": blames,
    }
    return found if entry.reading is None else {**found, "reading": entry.measured()}


def began(entry: Entry) -> tuple[int, str]:
    """Return what symptoms are put in order by."""
    return entry.began_ns, str(entry.literal)


def of_robot(robot: Robot, repair: Json | None) -> Headline:
    """Return the headline of a robot as it is now; `repair` is its newest, as HTTP shows it."""
    health, unknown = health_of(robot)
    behind = set(robot.not_judged())  # what is reported, and in no diagnosis yet
    unknown = tuple(atom for atom in unknown if atom not in behind)
    current = robot.current
    result = {} if current is None or current.result is None else current.result
    found = [one for one in result.get("diagnoses", ()) if one["bad"]]
    blamed: list[Weighed] = [(tuple(one["bad"]), one.get("probability")) for one in found]
    if repair is not None and repair["finished_ns"] is None and (newest := _round(repair)) is not None:
        weighed = _of_round(newest)
        if {bad for bad, _ in weighed} == {bad for bad, _ in blamed}:
            blamed = weighed  # what was tried is taken into account there
    entries = robot.obs.entries()
    since_ns = robot.found_ns
    if health is HealthState.HEALTHY:  # since all of it is known to be: before that nobody looked
        began_ns = (one.onset_ns for one in entries if one.literal.positive and one.atom.predicate != ACTIVE)
        since_ns = max(filter(None, (since_ns, *began_ns)), default=None)
    if health in UNCLEAR:
        lapsed = (one.expires_ns for one in entries if one.atom in unknown)
        over = [each for each in lapsed if each and each <= CLOCK.now_ns()]
        since_ns = (max if health is HealthState.UNKNOWN else min)(over) if over else None
    present = {one.source for one in entries if one.atom not in unknown}
    away = sorted({one.source for one in entries if one.expires_ns and one.atom in unknown} - present)
    conflicts = [(one["components"], one["observations"]) for one in result.get("conflicts", ())]
    fallen = robot.sight.symptoms()
    # That the water is too murky for a variant is nobody's fault, and follows from none.
    only_conditions = spoken_of(robot.system.conditions)
    symptoms = sorted((entry for entry in robot.sight.entries() if entry.atom in fallen), key=began)
    return headline(
        Facts(
            health=health,
            blamed=blamed,
            more=max(0, (result.get("count") or len(found)) - len(found)) if found else 0,
            symptoms=[
                one
                for entry in symptoms
                if (one := seen(entry, conflicts))["blames"] or entry.atom not in only_conditions
            ],
            unknown=[str(atom) for atom in unknown],
            waiting=bool(unknown) and unknown == robot.wait_for_themselves(),
            away=away,
            since_ns=since_ns,
            fault="" if current is None or not current.fault else str(current.fault.get("detail")),
            reported=bool(entries) or bool(robot.revision),
            policy=robot.config.policy,
            repair=repair,
            functions=list(_fallbacks(robot)),
            starved=starved(robot),
        )
    )


def starved(robot: Robot) -> list[tuple[str, int]]:
    """Return the robot's agents whose computers are starved, and since when."""
    agents = robot.sight.declared.agents()
    return [(one.agent, one.starved_ns) for one in agents if one.starved_ns is not None]


def starving(agent: str, since_ns: int) -> Told:
    """Return what people are told of an agent whose computer is overloaded."""
    said = f"the computer of agent {agent} has been overloaded since "
    return said, since_ns, ": what comes late is unknown"


def _fallbacks(robot: Robot) -> Iterator[Fallback]:
    """Yield the functions that are known not to work by their best variant, in the order of the model.

    Of one whose active variant is not known that no variant is left may be known.
    """
    for name, state in robot.function_states().items():
        best = next(iter(state.standings), None)
        if best is None:
            continue
        if all(one.admissible is False for one in state.standings.values()):
            yield Fallback(name, None, None, _measured(state.standings[best].why, robot))
            continue
        if state.active is None:
            continue
        standing = state.standings[state.active]
        if standing.admissible is False:  # until it is changed
            yield Fallback(name, state.active, None, _measured(standing.why, robot), works=False)
            continue
        if state.active == best:
            continue
        entry = robot.obs.get(Atom(ACTIVE, (name, state.active)))
        since_ns = None if entry is None else entry.onset_ns or entry.since_ns
        why = state.standings[best].why or (state.held if state.waits is None else state.waits[1])
        doubt = standing.why if standing.admissible is None else ""
        yield Fallback(name, state.active, since_ns, _measured(why, robot), doubt)


def _measured(why: str, robot: Robot) -> str:
    """Return why a variant is not admissible, with what was measured of what is observed not to hold."""

    def said(found: re.Match[str]) -> str:
        atom = _atom(found[1])
        entry = None if atom is None else robot.obs.get(atom)
        return observed({"literal": found[1], "reading": None if entry is None else entry.measured()})

    return re.sub(r"(not \w+\([^()]*\)) is observed", said, why)


def of_repair(repair: Json) -> Headline:
    """Return the headline of a robot by what its repair has written: what messages and events tell; of one
    that ended well, what was wrong.
    """
    if repair["state"] == RepairState.REPAIRED:
        return _of_repaired(repair)
    newest = _round(repair)
    blamed = _of_round(newest) if newest is not None else []
    if not blamed and (repair.get("diagnosis") or {}).get("bad"):
        blamed = [(tuple(repair["diagnosis"]["bad"]), None)]
    state = repair["state"]
    unconfirmed = state == RepairState.UNCONFIRMED
    health = HealthState.PARTLY_UNKNOWN if unconfirmed else HealthState.UNHEALTHY
    return headline(
        Facts(
            health=health,
            blamed=blamed,
            judged=bool(blamed) or repair["finished_ns"] is not None,
            symptoms=() if newest is None else newest.get("symptoms") or (),
            since_ns=repair["created_ns" if health is HealthState.UNHEALTHY else "finished_ns"],
            policy=repair.get("policy") or "approve",
            repair=repair,
        )
    )


def _of_repaired(repair: Json) -> Headline:
    rounds, end_ns = repair.get("rounds") or (), repair["finished_ns"]
    if not rounds:
        by_itself = ("Nothing was done: it became so by itself.",)
        return Headline(("Well again since ", end_ns, "."), by_itself, False, None, end_ns)
    first = rounds[0]
    symptoms = [{**one, "onset_ns": _since_when(one, repair)} for one in first.get("symptoms") or ()]
    facts = Facts(HealthState.UNHEALTHY, _of_round(first), symptoms=symptoms, since_ns=repair["created_ns"])
    what, since_ns = _what(facts)
    was: list[str | int] = []
    for part in what:
        if isinstance(part, int):
            was += [part, " to ", end_ns]
        else:  # what was measured stays as it is
            was.append(part if part.startswith(" (") else WAS.sub(lambda found: PAST[found[0]], part))
    acts, helped = _last_acts(repair)
    then = f"This helped: {acts}." if helped else f"It is not seen that this helped: {acts}."
    return Headline((*was, "."), (then if acts else "It became well by itself.",), False, None, since_ns)


def _last_acts(repair: Json) -> tuple[str, bool]:
    """Return what was done in the last round that did anything, and whether it is seen that it helped: what
    came back late, or by itself, may be due to any act.
    """
    done = [(one, [step for step in one["plan"] if step["state"] in SENT]) for one in repair["rounds"]]
    last, steps = next((each for each in reversed(done) if each[1]), done[-1])
    return _titles(steps), last.get("helped") is not False


PAST = {
    "has": "had",
    "is": "was",
    "does": "did",
    "reports": "reported",
    "follow": "followed",
    "follows": "followed",
    " since ": " from ",
}
WAS = re.compile(" since |" + "|".join(rf"(?<= ){verb}\b" for verb in PAST if verb.strip() == verb))
"""What is said of the present, and how the same was."""


def headline(of: Facts) -> Headline:
    """Return what people are told of a situation."""
    of = replace(of, symptoms=[{**one, "onset_ns": _since_when(one, of.repair)} for one in of.symptoms])
    what, since_ns = _what(of)
    if of.health is not HealthState.HEALTHY:
        for one in of.starved[:MANY]:
            what = (*what, "; ", *starving(*one))
    then, person, approve = _then(of)
    return Headline((*what, "."), then, person, approve, since_ns)


# --- what is wrong


def _what(of: Facts) -> tuple[Told, int | None]:
    if of.fault:
        return (f"There is no diagnosis: {short(of.fault)}",), of.since_ns
    doing = _under_way(of.repair)
    match of.health:
        case HealthState.HEALTHY:
            return ("Healthy", *_since(of.since_ns), *_working(of.functions)), of.since_ns
        case HealthState.UNKNOWN if not of.reported:
            return ("Nothing has been reported yet",), None
        case HealthState.UNKNOWN:
            return ("Nothing is heard of it", *_since(of.since_ns)), of.since_ns
        case HealthState.PARTLY_UNKNOWN:
            if not (missed := list(dict.fromkeys(map(_subject, of.unknown)))):
                return ("No fault is known, and what was observed is not judged yet",), of.since_ns
            are = "is" if len(missed) == 1 else "are"
            if doing:  # it is looked anew whether they are well
                acts = _listed([f"{name} is being {what}" for name, what in doing.items()])
                return (f"{acts}; {_listed(missed)} {are} not judged anew yet",), of.since_ns
            if of.waiting:
                each = "for each other" if len(missed) > 1 else "for itself"
                wait = "waits" if len(missed) == 1 else "wait"
                silent = f"{_listed(missed)} {are} not ok"
                return (f"{silent}, {wait} {each}, and {are} not known ever to have worked",), of.since_ns
            missing = (f"{_listed(missed)} {are} not observed", *_since(of.since_ns), "; no fault is known")
            return missing, of.since_ns
    faults = list(_faults(of))
    if not faults:
        why = ", and no diagnosis explains it" if of.judged else ""
        return (f"Something is wrong{why}", *_since(of.since_ns)), of.since_ns
    heads = {symptom["literal"] for _, symptom in faults if symptom is not None}
    shown = faults[:MANY]
    words: list[str | int] = []
    if len(faults) > 1:
        words.append(f"{_number(len(faults)).capitalize()} faults: ")
    for index, (cause, symptom) in enumerate(shown):
        words += ["; "] if index else []
        words += _fault(cause, symptom, of.since_ns, doing.get(cause.component, ""))
    if len(faults) > len(shown):
        words.append(f"; and {len(faults) - len(shown)} more")
    if of.health is HealthState.DEGRADED:
        words.append("; the robot works without it")
    if follow := [_subject(one["literal"]) for one in of.symptoms if one["literal"] not in heads]:
        words.append(f"; {_following(list(dict.fromkeys(follow)))}")
    words += _working(of.functions)
    first = next((symptom for _, symptom in faults if symptom is not None), None)
    return tuple(words), (first and _begun(first)) or of.since_ns


def _working(functions: Sequence[Fallback]) -> list[str | int]:
    """Return by what functions work that do not work by their best variant, since when and why."""
    words: list[str | int] = []
    for one in functions[:MANY]:
        how = f"{'works' if one.works else 'cannot work'} by {one.variant}" if one.variant else NONE_LEFT
        words += [f"; {one.function} {how}", *_since(one.since_ns)]
        words += [f", as {short(one.why)}"] if one.why else []
        words += [f"; whether it still does is unknown, as {short(one.doubt)}"] if one.doubt else []
    if len(functions) > MANY:
        words.append(f"; and {counted(len(functions) - MANY, 'more function')} not by the best variant")
    return words


@dataclass(frozen=True, slots=True)
class _Cause:
    """A component that is blamed, and those that could be in its place."""

    component: str
    share: float  # of the belief in any of them
    others: tuple[str, ...]


def _faults(of: Facts) -> Iterable[tuple[_Cause, Json | None]]:
    """Yield each fault of the leading diagnosis with the symptom that shows it."""
    if not of.blamed:
        return
    first = of.blamed[0][0]
    weighed = all(weight is not None for _, weight in of.blamed)
    weights = {bad: weight if weighed and weight is not None else 1.0 for bad, weight in of.blamed}
    total = sum(weights.values()) + (0 if weighed else of.more)
    told: set[str] = set()
    for component in first:
        rest = frozenset(first) - {component}
        places = (set(bad) - rest for bad, _ in of.blamed if rest <= set(bad))
        others = tuple(name for one in places if len(one) == 1 for name in one if name != component)
        share = sum(weight for bad, weight in weights.items() if component in bad) / (total or 1)
        symptom = _shown_by(component, rest, of.symptoms, told)
        if symptom is not None:
            told.add(symptom["literal"])
        yield _Cause(component, share, others), symptom


def _shown_by(
    component: str, rest: Collection[str], symptoms: Sequence[Json], taken: Collection[str]
) -> Json | None:
    """Return the symptom that shows a fault: its own state before what no other fault explains."""
    free = [one for one in symptoms if one["literal"] not in taken]
    own = [one for one in free if _own(one["literal"], component)]
    alone = [one for one in free if component in one.get("blames", ()) and not set(rest) & set(one["blames"])]
    rests = [one for one in free if component in one.get("blames", ())]
    unmarked = [one for one in free if "blames" not in one] if not rest else []  # of an older record
    return next(iter((*own, *alone, *rests, *unmarked)), None)


def _own(literal: str, component: str) -> bool:
    atom = _atom(literal)
    return atom is not None and atom.predicate in {"on", "running"} and atom.args == (component,)


def _under_way(repair: Json | None) -> dict[str, str]:
    """Return what is being done to components by the acts of an open repair that have begun: until they are
    seen to be in vain, nobody says what these components cause.
    """
    if repair is None or repair["state"] not in {RepairState.RUNNING, RepairState.VERIFYING}:
        return {}
    acts: dict[str, set[str]] = {}
    begun: set[str] = set()
    for step in repair["plan"]:
        for name in step["parameters"] if step["name"] in DOING else ():
            acts.setdefault(name, set()).add(step["name"])
            begun |= {name} if step["state"] in {StepState.RUNNING, StepState.DONE} else set()
    return {name: next(DOING[act] for act in DOING if act in acts[name]) for name in begun}


DOING = {
    "stop_node": "restarted",
    "start_node": "started",
    "shutdown": "power-cycled",
    "power_up": "switched on",
}
"""What is done to a component of which a plan has these acts, the first of them."""

OURS = {"restarted", "power-cycled"}
"""That it does not run, or has no power, is then what we do."""


def _fault(cause: _Cause, symptom: Json | None, since_ns: int | None, doing: str) -> list[str | int]:
    done = f"{cause.component} is being {doing}"
    own = symptom is not None and _own(symptom["literal"], cause.component)
    if doing and (symptom is None or (own and doing in OURS)):
        return [done]
    if symptom is None:
        return ["something is wrong", *_since(since_ns), _because(cause)]
    words: list[str | int] = [in_words(symptom["literal"], symptom.get("reading"))]
    words += _since(_begun(symptom) or since_ns)
    if measured := (symptom.get("reading") or {}).get("text"):
        words.append(f" ({short(str(measured))})")
    if doing and not own:
        words.append(f", and {done}")
    elif not own or cause.share < CERTAIN:
        words.append(_because(cause))
    return words


def _because(cause: _Cause) -> str:
    """Return who is blamed, and how surely."""
    names = (cause.component, *cause.others)
    if cause.share >= LIKELY or len(names) == 1:
        return f", {' '.join(filter(None, (surely(cause.share), 'because of', cause.component)))}"
    shown = names if len(names) <= MANY else (*names[: MANY - 1], "another")
    return f", because of one of {_number(len(names))}: {', '.join(shown[:-1])} or {shown[-1]}"


def surely(share: float) -> str:
    """Return how surely something is the cause, in words; of what is certain nothing."""
    if share >= CERTAIN:
        return "" if share > 1 - 1e-9 else "almost certainly"
    return "probably" if share >= LIKELY else "perhaps"


WAYS = {
    Symptom.SILENT: "is silent",
    Symptom.SLOW: "is too slow",
    Symptom.FAST: "is too fast",
    Symptom.STILL: "does not change",
    Symptom.OLD: "is out of date",
    Symptom.PUBLISHERS: "has too many publishers",
    Symptom.SELF_REPORT: "reports a fault of its own",
    Symptom.VALUE: "has a wrong value",
    Symptom.HALTED: "does not respond",
}
"""How what does not hold is said, where its observer says in which way it is bad."""

STATES = {
    "on": ("has power", "has no power"),
    "running": ("is running", "is not running"),
    "ok": ("is as it should be", "is not as it should be"),
}


def in_words(literal: str, reading: Json | None = None) -> str:
    """Return what was observed in words: `not on(hokuyo)` is "hokuyo has no power"."""
    atom, bad = _atom(literal), literal.startswith("not ")
    if atom is not None and atom.predicate == ACTIVE:
        return f"{atom.args[0]} {'does not work' if bad else 'works'} by {atom.args[1]}"
    if atom is None or len(atom.args) != 1:
        return literal
    way = (reading or {}).get("symptom")
    if bad and atom.predicate in {"ok", "running"} and way in WAYS:
        return f"{atom.args[0]} {WAYS[Symptom(way)]}"
    return f"{atom.args[0]} {STATES[atom.predicate][bad]}" if atom.predicate in STATES else literal


def observed(seen: Json) -> str:
    """Return what was observed in words, with what was measured: "scan is silent (0 of 10 Hz)"."""
    reading = seen.get("reading")
    return in_words(seen["literal"], reading) + (f" ({reading['text']})" if reading else "")


def question(atom: str) -> str:
    """Return what a person is asked to look at: `on(hokuyo)` is "does hokuyo have power?"."""
    parsed = _atom(atom)
    if parsed is not None and len(parsed.args) == 1:
        match parsed.predicate:
            case "on":
                return f"does {parsed.args[0]} have power?"
            case "running":
                return f"is {parsed.args[0]} running?"
            case "ok":
                return f"is {parsed.args[0]} as it should be?"
    return f"is {atom}?"


# --- what happens next

SENT = frozenset({StepState.RUNNING, StepState.DONE, StepState.FAILED})

DONE = "The actions are done; what is observed next shows whether they helped."


def _then(of: Facts) -> tuple[Told, bool, str | None]:
    """Return what happens next, whether a person is needed, and the repair that waits for a yes."""
    repair = of.repair
    if repair is not None and repair["finished_ns"] is None:
        return _of_open(repair)
    if of.fault:
        return ("A person is needed: the model or its limits have to be changed.",), True, None
    match of.health:
        case HealthState.HEALTHY:
            return _mended(repair), False, None
        case HealthState.UNKNOWN if not of.reported:
            return ("Start its agent, or report by hand what you see.",), False, None
        case HealthState.UNKNOWN:
            return ("A person is needed: are its agent and its network running?",), True, None
        case HealthState.PARTLY_UNKNOWN:
            if repair is not None and repair["state"] == RepairState.UNCONFIRMED:
                return (f"A person is needed to look: {short(repair['reason'])}.",), True, None
            if of.away:
                one = len(of.away) == 1
                words = f"{'Is' if one else 'Are'} {_listed(of.away)} running?"
                return (
                    (f"{words} {'It no longer reports' if one else 'They no longer report'}.",),
                    False,
                    None,
                )
            if of.waiting:
                return ("It is judged as soon as one of them is ok.",), False, None
            when = "as soon as it is reported" if of.unknown else "in a moment"
            return (f"It is judged {when}.",), False, None
    if of.policy == "observe":
        return ("A person is needed: robomend only observes it.",), True, None
    if repair is not None and repair["state"] != RepairState.REPAIRED:
        return _given_up(repair), True, None
    return ("No repair is under way yet.",), False, None


def _given_up(repair: Json) -> Told:
    how = {
        RepairState.CANCELLED: "the repair was cancelled",
        RepairState.FAILED: "the repair broke off",
        RepairState.UNCONFIRMED: "it is not seen to be well",
    }.get(repair["state"], "")
    why = ": ".join(filter(None, (how, short(repair["reason"] or "").rstrip("."))))
    words: list[str | int] = [f"A person is needed: {why or 'the last repair did not help'}"]
    words += [] if why.endswith("…") else ["."]
    if repair.get("retry_ns"):
        words += [" The next try is at ", repair["retry_ns"], "."]
    return tuple(words)


def _mended(repair: Json | None) -> Told:
    if repair is None or repair["state"] != RepairState.REPAIRED or not repair.get("rounds"):
        return ("Nothing is to be done.",)
    acts, helped = _last_acts(repair)
    if acts and not helped:
        what = f"; it is not seen that this helped: {acts}."
        return ("Nothing is to be done; well again at ", repair["finished_ns"], what)
    what = f": {acts}" if acts else ""
    return ("Nothing is to be done; repaired at ", repair["finished_ns"], f"{what}.")


def _of_open(repair: Json) -> tuple[Told, bool, str | None]:
    state, reason = repair["state"], short(repair["reason"] or "").rstrip(".")
    plan = repair["plan"]
    if state == RepairState.AWAITING_APPROVAL and plan:
        return (f"{_titles(plan)}?",), True, repair["id"]
    if state == RepairState.AWAITING_APPROVAL:
        return (
            (f"A person is asked: {reason.rstrip('?') or 'did the last action work'}?",),
            True,
            repair["id"],
        )
    if state == RepairState.WAITING and repair["waiting_for"]:
        probe = repair.get("probe")
        if probe is not None and repair["waiting_for"] == [probe["atom"]]:
            return (f"A look is needed: {question(probe['atom'])}",), True, None
        return (f"The repair waits to hear of {_atoms(repair['waiting_for'])}.",), False, None
    if state == RepairState.WAITING:
        return (f"The repair waits{': ' + reason if reason else ' for its turn'}.",), False, None
    if state == RepairState.PLANNING:
        return ("A repair is being planned.",), False, None
    if state == RepairState.RUNNING:
        running = [step for step in plan if step["state"] == StepState.RUNNING]
        running = running or [step for step in plan if step["state"] == StepState.WAITING][:1]
        if not running:
            return (DONE,), False, None
        done = sum(step["state"] in {StepState.DONE, StepState.ALREADY} for step in plan)
        at = f" (step {min(done + 1, len(plan))} of {len(plan)})" if len(plan) > 1 else ""
        acts = _titles(running)
        return (f"Under way: {acts[0].lower()}{acts[1:]}{at}.",), False, None
    if state == RepairState.VERIFYING:
        return (DONE,), False, None
    return (f"{str(state).capitalize()}.",), False, None


# --- words


def _titles(steps: Sequence[Json]) -> str:
    titles = action_titles(steps)
    return _listed([titles[0], *(one[0].lower() + one[1:] for one in titles[1:])]) if titles else ""


def _listed(names: Sequence[str]) -> str:
    return first_few(names, MANY - 1) if len(names) > MANY else listed(names)


def _atoms(atoms: Sequence[str]) -> str:
    return _listed(list(atoms))


def _following(names: Sequence[str]) -> str:
    if len(names) == 1:
        return f"{names[0]} follows"
    return f"{names[0]} and {names[1] if len(names) == 2 else f'{len(names) - 1} more'} follow"


def _since(time_ns: int | None) -> tuple[str | int, ...]:
    return () if time_ns is None else (" since ", time_ns)


def _since_when(symptom: Json, repair: Json | None) -> int | None:
    """Return when a symptom began: what a vain repair took away for a moment is as old as before it."""
    now = _begun(symptom)
    if repair is None or now is None or now > (repair["finished_ns"] or now):
        return now
    seen = (one for done in repair.get("rounds") or () for one in done.get("symptoms") or ())
    tried = (_begun(one) for one in seen if one["literal"] == symptom["literal"])
    return min([now, *filter(None, tried)])


def _begun(symptom: Json) -> int | None:
    found: int | None = symptom.get("onset_ns") or symptom.get("since_ns")
    return found


def _number(count: int) -> str:
    return NUMBERS[count] if count < len(NUMBERS) else str(count)


def short(text: str) -> str:
    """Return as much of a text as a headline has room for, in one line and as people say it: whole clauses,
    where the first of them fits.
    """
    text = in_prose(" ".join(text.split()))
    if len(text) <= LETTERS:
        return text
    whole = text[: LETTERS + 1].rpartition("; ")[0]
    return whole or f"{text[:LETTERS].rsplit(' ', 1)[0]} …"


def _subject(literal: str) -> str:
    atom = _atom(literal)
    return literal if atom is None or len(atom.args) != 1 else atom.args[0]


def _atom(literal: str) -> Atom | None:
    try:
        return parse_atom(literal.removeprefix("not "))
    except ValueError:
        return None


# --- of what is written


def _round(repair: Json) -> Json | None:
    """Return what a repair rests on: its newest round, or what it found that nothing mends."""
    rounds = repair.get("rounds")
    newest: Json | None = repair.get("unmended") or (rounds[-1] if rounds else None)
    return newest


def _of_round(done: Json) -> list[Weighed]:
    """Return what a round was chosen from: each diagnosis with its weight, the chosen one first."""
    chosen = (tuple(done["diagnosis"]["bad"]), done.get("weight"))
    rivals = [(tuple(one["bad"]), one["weight"]) for one in done.get("rivals") or ()]
    return [chosen, *rivals]
