"""SUNSET, the managed system of arXiv 2504.20477, simulated from what is published of its nodes; and the
selection of strategies that its authors compare, as a stand-in.

    camera ──► rgb_camera ──┬──► image_enhancement ──► rgb_enhanced ──┐
                            └──────────────────── or ─────────────────┴──► sensor_fusion ──► segmentation

A scenario is one node that drops its messages, one fault of the picture, and a camera that is out of focus.

    drop         a lifecycle restart (1 s) or a redeployment (5 s, assumed) ends it
    hard drop    a redeployment alone
    dark         for 20 s; a restart of the camera ends it, the enhancement makes up for it
    shift        of the fused picture: recalibrating ends it, once a picture is fused
    unfocused    each picture takes half a second longer, until the camera focuses

A strategy is needless if it ended nothing, or redeployed what a restart would have cured, and on a wrong
component if what it is for was not the matter with that.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

from robomend_bench.faults.condition import Act
from robomend_client.actions import FAILED, OK

Values = Mapping[str, object]

PERIOD_S = 0.2
"""Of the recorded pictures, 25 a second, played at a fifth of their speed."""

UNFOCUSED_S = 0.5
DARK_S = 20.0
RESTART_S, REDEPLOY_S, PARAMETER_S = 1.0, 5.0, 0.1
GOOD_ENTROPY, BAD_ENTROPY, MOST_ENTROPY = 0.03, 0.12, 0.06

CAMERA, ENHANCEMENT, FUSION, SEGMENTATION = "camera", "image_enhancement", "sensor_fusion", "segmentation"
NODES = (CAMERA, FUSION, SEGMENTATION)

Triple = tuple[str, str, str]  # dark or shift, the node that drops, drop or hard

SCENARIOS: tuple[tuple[Triple, int], ...] = (
    (("dark", CAMERA, "drop"), 9),
    (("dark", SEGMENTATION, "drop"), 8),
    (("dark", FUSION, "drop"), 2),
    (("dark", FUSION, "hard"), 6),
    (("shift", CAMERA, "drop"), 1),
    (("shift", SEGMENTATION, "drop"), 1),
    (("shift", FUSION, "drop"), 9),
    (("shift", CAMERA, "hard"), 7),
    (("shift", SEGMENTATION, "hard"), 7),
)
"""The fifty fixed scenarios: nine different ones, each so often. All have a camera out of focus as well."""


def scenarios(count: int = 50) -> list[Triple]:
    """Return so many of the fifty, each kind as early as it can come."""
    left = dict(SCENARIOS)
    found: list[Triple] = []
    while len(found) < count and any(left.values()):
        for triple, often in left.items():
            if often and len(found) < count:
                left[triple] = often - 1
                found.append(triple)
    return found


@dataclass
class Strategy:
    """One that was carried out, and what came of it."""

    at_s: float
    act: Act
    wrong: bool  # nothing was the matter with what it acted on
    needless: bool = True
    redeployed: bool = False  # it was a redeployment, and needless


@dataclass
class Sunset:
    """See the module. Time is passed in; `messages` is what its topics and diagnostics have said since."""

    now_s: float = 0.0
    drops: dict[str, str] = field(default_factory=dict)  # node -> drop or hard
    down: set[str] = field(default_factory=set)  # nodes that restart or are redeployed
    gone: set[str] = field(default_factory=set)  # those of them whose process is away
    dark: bool = False
    shifted: bool = False
    unfocused: bool = False
    enhanced: bool = False  # the enhancement is active, and its picture is what is fused
    began_s: float = math.inf
    clear_s: float | None = None  # when first all was as it should be
    strategies: list[Strategy] = field(default_factory=list)
    messages: list[tuple[str, float, Values]] = field(default_factory=list)
    _next_s: float = 0.0  # when the camera takes its next picture
    _bright_s: float = math.inf  # when the dark is over
    _pending: set[str] = field(default_factory=set)  # parameters that a node has not looked at yet
    _ends: list[tuple[float, int, Strategy]] = field(default_factory=list)

    def plant(self, triple: Triple) -> None:
        """All three begin."""
        picture, node, how = triple
        self.drops[node] = how
        self.dark, self.shifted, self.unfocused = picture == "dark", picture == "shift", True
        self.began_s = self.now_s

    @property
    def wrong(self) -> frozenset[str]:
        """What is the matter."""
        picture = self.dark != self.enhanced
        others = {"picture": picture, "shift": self.shifted, "unfocused": self.unfocused}
        found = {name for name, so in others.items() if so} | {f"{node} down" for node in self.down}
        return frozenset(found | {f"{how} {node}" for node, how in self.drops.items()})

    # --- time

    def advance(self, now_s: float) -> None:
        """Let time pass: pictures go through the nodes, acts under way end."""
        while True:
            picture_s = self._next_s
            act_s = self._ends[0][0] if self._ends else math.inf
            at_s = min(picture_s, act_s)
            if at_s > now_s:
                break
            self.now_s = at_s
            if act_s <= picture_s:
                self._end(heapq.heappop(self._ends)[2])
            else:
                self._picture()
        self.now_s = now_s

    def _picture(self) -> None:
        at_s = self.now_s
        self._next_s = at_s + PERIOD_S
        self.messages.append(("sensor_fusion", at_s, {"enhanced": float(self.enhanced)}))
        if CAMERA in self.down:
            return
        if self.unfocused:
            at_s = self._next_s = at_s + UNFOCUSED_S
            self.messages.append((CAMERA, at_s, {"autofocus_needed": 1.0}))
        if "autofocus" in self._pending:
            self._pending.discard("autofocus")
            self.unfocused = False
            self._next_s = at_s + PERIOD_S
            self.messages.append((CAMERA, at_s, {"autofocus_needed": 0.0}))
        if self.dark and math.isinf(self._bright_s):
            self._bright_s = at_s + DARK_S
        if at_s >= self._bright_s:
            self.dark, self._bright_s = False, math.inf
        if CAMERA in self.drops:
            return
        self.messages.append(("rgb_camera", at_s, {}))
        self.messages.append(("is_image_degraded", at_s, {"is_degraded": float(self.dark)}))
        if FUSION in self.down or FUSION in self.drops:
            return
        if "recalibrate" in self._pending:
            self._pending.discard("recalibrate")
            self.shifted = False
        self.messages.append(("sensors_fused", at_s, {}))
        if SEGMENTATION in self.down or SEGMENTATION in self.drops:
            return
        bad = self.shifted or self.dark != self.enhanced
        self.messages.append((SEGMENTATION, at_s, {"entropy": BAD_ENTROPY if bad else GOOD_ENTROPY}))
        if self.clear_s is None and not self.wrong and not math.isinf(self.began_s):
            self.clear_s = at_s

    def running(self) -> frozenset[str]:
        """Return the nodes whose processes are there."""
        return frozenset((*NODES, ENHANCEMENT)).difference(self.gone)

    # --- acts

    def begin(self, act: Act) -> float:
        """Begin a strategy; return how long it takes until its answer."""
        name, on = act.name, act.parameters[0]
        of_camera = self.dark or self.unfocused
        matter = {
            "reactivate": on in self.drops or (on == CAMERA and self.dark and name == "reactivate"),
            "recalibrate": self.shifted or FUSION in self.drops,
            "autofocus": of_camera or CAMERA in self.drops,
            "show": self.dark != self.enhanced,
        }
        wrong = not matter["reactivate" if name == "redeploy" else name]
        strategy = Strategy(self.now_s, act, wrong, redeployed=name == "redeploy")
        self.strategies.append(strategy)
        takes_s = {"reactivate": RESTART_S, "redeploy": REDEPLOY_S}.get(name, PARAMETER_S)
        if takes_s > PARAMETER_S:
            self.down.add(on)
        if name == "redeploy":
            self.gone.add(on)
        heapq.heappush(self._ends, (self.now_s + takes_s, len(self.strategies), strategy))
        return takes_s

    def _end(self, strategy: Strategy) -> None:
        name, on = strategy.act.name, strategy.act.parameters[0]
        before = self.wrong
        cures = self.drops.get(on) == ("hard" if name == "redeploy" else "drop")
        if name in {"reactivate", "redeploy"}:
            self.down.discard(on)
            self.gone.discard(on)
            if name == "redeploy" or self.drops.get(on) == "drop":
                self.drops.pop(on, None)
            if on == CAMERA:
                cures = cures or (self.dark and name == "reactivate")
                self.dark, self._bright_s = False, math.inf
                self._next_s = max(self._next_s, self.now_s)
            if name == "redeploy":  # its parameters are those of its file
                self.unfocused = self.unfocused and on != CAMERA
                self.shifted = self.shifted and on != FUSION
                self.enhanced = self.enhanced and on not in {FUSION, ENHANCEMENT}
        elif name == "autofocus":
            cures = self.unfocused and CAMERA not in self.gone and "autofocus" not in self._pending
            self._pending |= {name} if CAMERA not in self.gone else set()
        elif name == "recalibrate":
            cures = self.shifted and FUSION not in self.gone and "recalibrate" not in self._pending
            self._pending |= {name} if FUSION not in self.gone else set()
        elif name == "show" and FUSION not in self.gone:
            self.enhanced = on == "enhanced"
            cures = "picture" in before - self.wrong
        strategy.needless = not cures
        strategy.redeployed = name == "redeploy" and not cures

    def code(self, act: Act) -> int:
        """Return the answer of an act that has ended: parameters of a process that is away are refused."""
        of = {"autofocus": CAMERA, "recalibrate": FUSION, "show": FUSION}.get(act.name)
        return FAILED if of in self.gone else OK


ACTS = (
    Act("autofocus", ("lens",)),
    Act("recalibrate", ("calibration",)),
    *(Act(name, (node,)) for name in ("reactivate", "redeploy") for node in NODES),
    Act("show", ("raw",)),
    Act("show", ("enhanced",)),
)


# --- the rival's selection, from its published rules and code
#
# Each TICK_S the rules are looked at. One that holds asks for a strategy; what was tried is not tried again
# until the rule has been cured. A strategy has its execution estimate, and a tick more, to cure it.

FAILURE, DEGRADED, FINE = 2, 1, 0

TICK_S, BLACKBOARD_S = 0.2, 0.7
"""Of the behaviour tree, and of what it is told."""

WINDOW, LEAST_HZ = 4, 1.0
"""A topic's rate is the most that its newest messages say; below so much it is dead."""

ESTIMATES = {"reactivate": 25, "redeploy": 50, "show": 12, "autofocus": 1, "recalibrate": 1}
"""Ticks that a strategy is given."""

IMPACT_OF_ALL = 25.0
"""What the estimates are divided by in the cost."""

UPSTREAM = {
    CAMERA: frozenset[str](),
    ENHANCEMENT: frozenset({CAMERA}),
    FUSION: frozenset({CAMERA}),
    SEGMENTATION: frozenset({CAMERA, FUSION}),
}


@dataclass
class RivalStrategy:
    """What a rule may do, and how probably it helps, in percent."""

    act: Act
    rate: float
    on: frozenset[str]
    tried: bool = False

    def cost(self, by_cost: bool) -> float:
        """Return what it is sorted by."""
        if not by_cost:
            return 100 - self.rate
        return 0.5 * (1 - self.rate / 100) + 0.5 * (ESTIMATES[self.act.name] - 1) / IMPACT_OF_ALL


@dataclass
class Rule:
    """A symptom, how bad it is, and the strategies against it."""

    name: str
    level: int
    strategies: list[RivalStrategy]


@dataclass(frozen=True)
class Options:
    """What the rival's selection takes into account."""

    dependencies: bool = False
    criticality: bool = False
    cost: bool = False
    sees_dark: bool = False  # a rule of ours: it is told by the camera that the picture is dark


def _rules(options: Options) -> list[Rule]:
    def strategy(name: str, parameter: str, rate: float, *on: str) -> RivalStrategy:
        return RivalStrategy(Act(name, (parameter,)), rate, frozenset(on))

    dead = [
        Rule(node, FAILURE, [strategy("reactivate", node, 40, node), strategy("redeploy", node, 60, node)])
        for node in NODES
    ]
    enhance = strategy("show", "enhanced", 12, ENHANCEMENT, FUSION)
    bad = [
        strategy("recalibrate", "calibration", 80, FUSION),
        strategy("show", "raw", 8, ENHANCEMENT, FUSION),
    ]
    found = [Rule("unfocused", FINE, [strategy("autofocus", "lens", 100, CAMERA)])]
    if options.sees_dark:
        enhance.rate = 100
        found.append(Rule("dark", DEGRADED, [enhance]))
    else:
        bad.append(enhance)
    return [*found, Rule("entropy", DEGRADED, bad), *dead]


TOPIC_OF = {CAMERA: "rgb_camera", FUSION: "sensors_fused", SEGMENTATION: SEGMENTATION}


class Rival:
    """The stand-in: it acts on a system whose time it lets pass."""

    def __init__(self, system: Sunset, options: Options) -> None:
        self._system = system
        self._options = options
        self._rules = _rules(options)
        self._heard: dict[str, list[float]] = {topic: [] for topic in TOPIC_OF.values()}
        self._said: dict[str, float] = {}  # as the diagnostics have it
        self._board: dict[str, float] = {}  # as the tree was told
        self._asking: dict[str, Rule] = {}
        self._adapted: dict[str, int] = {}  # rule -> ticks since its strategy was given
        self._given: list[tuple[Rule, RivalStrategy]] = []
        self._health: dict[str, int] = {}
        self._busy: dict[str, float] = {}  # component -> until when it is acted on

    def play(self, until_s: float) -> None:
        """Tick until then."""
        system = self._system
        ticks = math.ceil((until_s - system.now_s) / TICK_S)
        told_s = system.now_s
        for _ in range(ticks):
            system.advance(system.now_s + TICK_S)
            self._hear()
            if system.now_s >= told_s:
                told_s += BLACKBOARD_S
                self._board = dict(self._said)
                self._board |= {node: self._rate(topic) for node, topic in TOPIC_OF.items()}
            self._tick()

    def _hear(self) -> None:
        for topic, at_s, values in self._system.messages:
            if topic in self._heard:
                self._heard[topic] = [*self._heard[topic][-WINDOW + 1 :], at_s]
            self._said.update({name: float(str(value)) for name, value in values.items()})
        self._system.messages.clear()

    def _rate(self, topic: str) -> float:
        heard = self._heard[topic][::-1]
        if len(heard) < WINDOW:
            return math.inf if math.isinf(self._system.began_s) else 0.0
        now_s = self._system.now_s
        return max((number / max(now_s - at_s, 1e-3) for number, at_s in enumerate(heard, start=1)))

    def _holds(self, rule: Rule) -> bool:
        if not self._board:
            return False
        if rule.name in TOPIC_OF:
            return self._board[rule.name] < LEAST_HZ
        of, bound = {
            "unfocused": ("autofocus_needed", 0.5),
            "dark": ("is_degraded", 0.5),
            "entropy": ("entropy", MOST_ENTROPY),
        }[rule.name]
        return self._board.get(of, 0.0) > bound

    def _tick(self) -> None:
        self._adapted = {name: ticks + 1 for name, ticks in self._adapted.items()}
        for rule, strategy in self._given:
            strategy.tried = True
            self._adapted[rule.name] = -ESTIMATES[strategy.act.name]
            self._asking.pop(rule.name, None)
        self._given = []
        for rule in self._rules:
            self._analyse(rule)
        for level in (FAILURE, DEGRADED, FINE):
            self._select(level)

    def _analyse(self, rule: Rule) -> None:
        adapted = self._adapted.get(rule.name)
        components = frozenset[str]().union(*(strategy.on for strategy in rule.strategies))
        if self._holds(rule):
            if adapted is None and rule.name not in self._asking:
                for strategy in rule.strategies:
                    strategy.tried = False
                self._asking[rule.name] = rule
                self._health.update(dict.fromkeys(components, rule.level))
            elif adapted is not None and adapted > 1:
                del self._adapted[rule.name]
                self._asking[rule.name] = rule
        elif (adapted is not None and adapted >= 1) or rule.name in self._asking:
            self._adapted.pop(rule.name, None)
            self._asking.pop(rule.name, None)
            self._health.update(dict.fromkeys(components, FINE))

    def _select(self, level: int) -> None:
        system, options = self._system, self._options
        found = [
            (rule, strategy)
            for rule in self._asking.values()
            if rule.level == level
            for strategy in rule.strategies
            if not strategy.tried
        ]
        found.sort(key=lambda each: each[1].cost(options.cost))
        for rule, strategy in found:
            given = any(other is rule for other, _ in self._given)
            if given or not all(self._may(component, level) for component in strategy.on):
                continue
            self._given.append((rule, strategy))
            takes_s = system.begin(strategy.act)
            self._busy.update(dict.fromkeys(strategy.on, system.now_s + takes_s))

    def _may(self, component: str, level: int) -> bool:
        if self._busy.get(component, -math.inf) > self._system.now_s:
            return False
        if not self._options.dependencies:
            return True
        return not any(self._stands_in_the_way(name, level) for name in UPSTREAM[component])

    def _stands_in_the_way(self, name: str, level: int) -> bool:
        if self._options.criticality:
            return self._health.get(name, FINE) >= max(level, DEGRADED)
        return self._busy.get(name, -math.inf) > self._system.now_s


def with_rival(triples: Iterable[Triple], options: Options, until_s: float = 60.0) -> list[Sunset]:
    """Return the systems after the rival had them, each with faults that began at another phase."""
    played = []
    for number, triple in enumerate(triples):
        system = Sunset()
        rival = Rival(system, options)
        rival.play(5.0 + 0.07 * (number % 10))
        system.plant(triple)
        rival.play(system.began_s + until_s)
        played.append(system)
    return played
