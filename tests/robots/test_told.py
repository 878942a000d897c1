"""What is written by hand as JSON is what the encoder would write."""

from __future__ import annotations

import json

from hypothesis import given
from hypothesis import strategies as st

from robomend.api.views import accepted_response
from robomend.errors import ObservationError
from robomend.robots.batches import Acknowledged
from robomend.store.batch_text import told
from robomend_client.literals import Atom

TEXTS = st.lists(st.text(), max_size=3)


@given(st.integers(0, 2**63), TEXTS, TEXTS, st.integers(0, 2**63))
def test_the_event_of_a_batch(revision: int, changed: list[str], forgotten: list[str], at_ns: int) -> None:
    event = told(revision, changed, [Atom("ok", (text,)) for text in forgotten], at_ns)
    assert event.text == json.dumps(event, separators=(",", ":"))
    assert event.own == event.text


@given(st.integers(0, 2**63), TEXTS, st.booleans())
def test_the_answer_to_a_batch(revision: int, changed: list[str], refuses: bool) -> None:
    refused = [ObservationError('why "so"', "ok(", 3)] if refuses else []
    answer = accepted_response(Acknowledged(revision, changed, refused))
    assert json.loads(bytes(answer.body)) == {
        "revision": revision,
        "changed": changed,
        "refused": [{"sentence": "ok(", "position": 3, "message": 'why "so"'}] if refuses else [],
    }
