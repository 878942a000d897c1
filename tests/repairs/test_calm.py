"""Whether a verdict that is about to come could change the first act."""

from __future__ import annotations

from collections.abc import Iterable
from types import SimpleNamespace
from typing import Any, cast

import pytest

from robomend.diagnosis.result import Diagnosis, DiagnosisResult
from robomend.planning.choice import Choice
from robomend.repairs.calm import Calm
from robomend_client.literals import Atom, Literal

pytestmark = pytest.mark.anyio

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
    state = cast(Any, SimpleNamespace(sight=SimpleNamespace(literals=lambda: known)))
    nobody = cast(Any, None)
    return Calm(state, nobody, nobody, frozenset(), newest, diagnose, choose, 5.0)


async def test_what_is_repaired_in_any_case_need_not_wait() -> None:
    other = diagnosed(("mapping", "driver"), ("mapping",))
    assert not await calm(other)._may_change(diagnosed(("mapping",)), [SCAN])


async def test_health_would_change_it() -> None:
    assert await calm(diagnosed(()))._may_change(diagnosed(("mapping",)), [SCAN])


async def test_where_no_diagnosis_was_found_in_time_one_waits_for_more() -> None:
    assert await calm(diagnosed())._may_change(diagnosed(), [SCAN])
