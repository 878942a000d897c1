"""Whether a verdict that is about to come could change the first act."""

from __future__ import annotations

from collections.abc import AsyncIterator, Iterable
from contextlib import asynccontextmanager
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest
from tests.repairs.robot import CONFIG, MODEL, put_robot, service

from robomend.api.runtime import Runtime
from robomend.diagnosis.result import Diagnosis, DiagnosisResult
from robomend.planning.choice import Choice
from robomend.repairs.calm import MOST_FLIPS, Calm
from robomend.repairs.hearing import Hearing
from robomend.robots.batches import Batch
from robomend.robots.clock import CLOCK
from robomend.store.records import StoredStart
from robomend_client.actions import Action
from robomend_client.literals import Atom, Literal

pytestmark = pytest.mark.anyio

S = 10**9
SCAN, MAP = Atom("ok", ("scan",)), Atom("ok", ("map",))


def diagnosed(*bad: tuple[str, ...]) -> DiagnosisResult:
    found = tuple(Diagnosis(one) for one in bad)
    return DiagnosisResult(("driver", "mapping"), found, True, None, (), 0.0)


def calm(other: DiagnosisResult) -> Calm:
    """Return one to whom every other set of observations has the same diagnoses; nothing is planned."""

    async def diagnose(literals: Iterable[Literal]) -> DiagnosisResult:
        return other

    async def choose(result: DiagnosisResult, literals: Iterable[Literal]) -> Choice:
        raise AssertionError("nothing needs to be planned for this")

    async def newest() -> DiagnosisResult:
        raise AssertionError("nothing is waited for")

    known = (Literal(SCAN), Literal(MAP, False))
    sight, system = SimpleNamespace(vouched=lambda: known), SimpleNamespace(parts=None)
    state = cast(Any, SimpleNamespace(sight=sight, system=system))
    nobody = cast(Any, None)
    return Calm(state, nobody, nobody, frozenset(), newest, diagnose, choose, lambda name: 5.0)


async def test_what_is_repaired_in_any_case_need_not_wait() -> None:
    other = diagnosed(("mapping", "driver"), ("mapping",))
    assert not await calm(other)._may_change(diagnosed(("mapping",)), [SCAN])


async def test_a_verdict_that_takes_one_more_fault_is_not_waited_for() -> None:
    """Faults that have nothing to do with each other begin in the same second once in a robot's life."""
    now, more = diagnosed(("mapping",), ("driver",)), diagnosed(("mapping", "base"), ("driver", "base"))
    assert not await calm(more)._may_change(now, [SCAN])


async def test_health_would_change_it() -> None:
    assert await calm(diagnosed(()))._may_change(diagnosed(("mapping",)), [SCAN])


async def test_where_no_diagnosis_was_found_in_time_one_waits_for_more() -> None:
    assert await calm(diagnosed())._may_change(diagnosed(), [SCAN])


async def said(runtime: Runtime, now_ns: int, by: str = "agent", **verdicts: tuple[bool, float]) -> None:
    """Report topics, good or bad, and for how long they have been so."""
    batch = Batch(
        [f"ok({topic})" if good else f"not ok({topic})" for topic, (good, _) in verdicts.items()],
        source=by,
        time_ns=now_ns,
        since=[now_ns - round(long_s * S) for _, long_s in verdicts.values()],
        onset=[None if good else now_ns - round(long_s * S) for good, long_s in verdicts.values()],
    )
    await runtime.robots.observe("r1", batch)


@asynccontextmanager
async def waiting_for_verdicts(
    tmp_path: Path, model: str = MODEL, **about: Any
) -> AsyncIterator[tuple[Runtime, Calm]]:
    """A robot whose verdicts take a minute, and what a repair of it waits for."""
    config = {**CONFIG, "policy": "observe", "detection_s": 60.0, **about}
    async with service(tmp_path) as runtime:
        await put_robot(runtime, model, **config)
        state = await runtime.robots.memory.robot("r1")
        nobody = cast(Any, None)
        yield runtime, Calm(state, nobody, nobody, frozenset(), nobody, nobody, nobody, lambda name: 0.0)


async def test_what_rests_on_a_topic_that_is_back_by_itself_is_given_time_to_come_back(
    tmp_path: Path,
) -> None:
    async with waiting_for_verdicts(tmp_path) as (runtime, calm):
        now_ns = CLOCK.now_ns()
        await said(runtime, now_ns - 200 * S, scan=(True, 1), map=(True, 1))
        await said(runtime, now_ns - 90 * S, scan=(False, 10), map=(False, 10))
        assert MAP not in calm._pending()
        await said(runtime, now_ns - 5 * S, scan=(True, 2))
        pending = calm._pending()
        assert pending[MAP] > now_ns + 50 * S
        assert SCAN not in pending


async def test_what_lapsed_a_moment_ago_is_waited_for_and_what_has_long_is_not(tmp_path: Path) -> None:
    async def said(runtime: Runtime, time_ns: int, sentence: str) -> None:
        batch = Batch([sentence], source="agent", time_ns=time_ns, since=[time_ns], lifetime_s=2.0)
        await runtime.robots.observe("r1", batch)

    config = {**CONFIG, "policy": "observe"}
    async with service(tmp_path) as runtime:
        await put_robot(runtime, MODEL, **config)
        state = await runtime.robots.memory.robot("r1")
        now_ns = CLOCK.now_ns()
        nobody = cast(Any, None)
        calm = Calm(state, nobody, nobody, frozenset(), nobody, nobody, nobody, lambda name: 0.0)
        for ago_s, sentence in ((300.0, "ok(odom)"), (2.2, "ok(scan)"), (1.0, "not ok(map)")):
            await said(runtime, now_ns - round(ago_s * S), sentence)
        pending = calm._pending()
    assert pending.keys() == {SCAN}
    assert now_ns < pending[SCAN] < now_ns + 2 * S


async def test_once_all_were_heard_what_rests_on_the_suspects_need_not_be_heard_again(
    tmp_path: Path,
) -> None:
    """Nobody can say how it is: a trend of what is silent, or whether two values match."""
    about: dict[str, Any] = {"observed": ["ok(scan)", "ok(map)", "running(lidar_node)", "ok(odom)"]}
    async with waiting_for_verdicts(tmp_path, **about) as (runtime, _):
        state, nobody = await runtime.robots.memory.robot("r1"), cast(Any, None)
        record = cast(Any, SimpleNamespace(data={}))
        hearing = Hearing(runtime.store, runtime.robots, state, record, nobody, None)
        await said(runtime, CLOCK.now_ns() - S, scan=(False, 2))
        await runtime.robots.diagnosed("r1")
        assert {str(atom) for atom in await hearing.unheard()} == {
            "ok(map)",
            "ok(odom)",
            "running(lidar_node)",
        }
        hearing._complete = True
        assert {str(atom) for atom in await hearing.unheard()} == {"ok(odom)", "running(lidar_node)"}


async def test_of_many_pending_verdicts_only_those_count_that_the_suspects_may_turn(tmp_path: Path) -> None:
    """With more than are tried one by one, and none that has to do with what is wrong, nobody waits."""
    others = "".join(f"  n{n}: {{publishes: {{t{n}: []}}}}\n" for n in range(2 * MOST_FLIPS))
    async with waiting_for_verdicts(tmp_path, MODEL + others) as (runtime, _):
        state = await runtime.robots.memory.robot("r1")
        now_ns = CLOCK.now_ns()
        good = {f"t{n}": (True, 1.0) for n in range(2 * MOST_FLIPS)}
        await said(runtime, now_ns, "agent", scan=(False, 1), map=(False, 1), **good)
        nobody = cast(Any, None)
        about = partial(runtime.robots.diagnosing.of, state)

        async def choose(result: DiagnosisResult, literals: Iterable[Literal]) -> Choice:
            raise AssertionError("nothing needs to be planned for this")

        calm = Calm(state, nobody, nobody, frozenset(), nobody, about, choose, lambda name: 0.0)
        result = await about(state.literals())
        pending = [Atom("ok", (topic,)) for topic in good]
        assert not await calm._may_change(result, pending)
        with pytest.raises(AssertionError, match="planned for"):  # the suspects may turn this one
            await calm._may_change(result, [*pending, Atom("on", ("lidar",))])


async def test_what_rests_on_what_was_started_is_judged_anew_once_that_is_back(tmp_path: Path) -> None:
    """The start took as long as the earlier ones, and was too short for its own observer to see a gap."""
    async with waiting_for_verdicts(tmp_path) as (runtime, calm):
        state, now_ns = await runtime.robots.memory.robot("r1"), CLOCK.now_ns()
        assert state.system.parts is not None
        state.sight.start_ups.recall({"scan": [StoredStart(S // 10, S // 10, False)]}, state.system.parts)
        await said(runtime, now_ns - 200 * S, scan=(True, 1), map=(True, 1))
        for sentence, time_ns in (("not running(lidar_node)", 4 * S), ("running(lidar_node)", 3 * S)):
            since_ns = now_ns - time_ns
            batch = Batch([sentence], source="agent", time_ns=since_ns, since=[since_ns], onset=[since_ns])
            await runtime.robots.observe("r1", batch)
            if time_ns == 4 * S:
                state.sight.start_ups.acted(
                    Action("a", "start_node", ("lidar_node",), 1.0), since_ns, since_ns
                )
        await said(runtime, now_ns, scan=(True, 2), map=(False, 3))
        assert calm._pending()[MAP] > now_ns + 50 * S
