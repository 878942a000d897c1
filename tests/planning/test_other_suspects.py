"""What is awaited where only what all diagnoses share is repaired: nothing that another one can prevent."""

from __future__ import annotations

from robomend.diagnosis.result import Diagnosis, DiagnosisResult
from robomend.model.loading import load_text
from robomend.planning.advice import other_suspects
from robomend.planning.prediction import Prediction, theory_of
from robomend_client.literals import Atom, holds

SYSTEM = load_text(
    "robomend: 1\nhardware: {cam: {channel: 1}}\nnodes:\n"
    "  cam_d: {drives: cam, publishes: [img]}\n  task: {publishes: {state: [img]}}\n"
)
RESULT = DiagnosisResult(
    SYSTEM.cnf.components, (Diagnosis(("cam", "task")), Diagnosis(("cam_d", "task"))), True, None, (), 0.0
)


def test_only_what_other_suspects_cannot_prevent_is_awaited_while_the_shared_part_is_repaired() -> None:
    assert other_suspects(("task",), RESULT) == {"cam", "cam_d"}
    good = [Atom("good", (name,)) for name in SYSTEM.cnf.components]
    theory, left = theory_of(SYSTEM.cnf), other_suspects(("task",), RESULT)
    sure = Prediction(theory, [c for c in SYSTEM.cnf.components if c not in left], good).expected()
    assert sure == {holds("running", "task")}
    assert holds("ok", "state") in Prediction(theory, SYSTEM.cnf.components, good).expected()


def test_a_whole_diagnosis_leaves_no_other_suspects() -> None:
    assert other_suspects(("cam", "task"), RESULT) == frozenset()
