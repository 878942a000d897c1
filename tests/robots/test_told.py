"""What is written by hand as JSON is what the encoder would write."""

from __future__ import annotations

import json

from hypothesis import given
from hypothesis import strategies as st

from robomend.api.ingestion import accepted_response
from robomend.entry import Entry
from robomend.errors import ObservationError
from robomend.robots.batches import Acknowledged
from robomend.store.encoding import told
from robomend_client.literals import Atom, Literal
from robomend_client.readings import Reading

TEXTS = st.lists(st.text(), max_size=3)


@given(st.integers(0, 2**63), TEXTS, TEXTS, st.integers(0, 2**63))
def test_the_event_of_a_batch(revision: int, changed: list[str], forgotten: list[str], at_ns: int) -> None:
    new = [
        Entry(Literal(Atom("ok", (text,))), "a", 1, reading=Reading(text) if text else None)
        for text in changed
    ]
    event = told(revision, new, [Atom("ok", (text,)) for text in forgotten], at_ns)
    assert event["changed"] == [str(entry.literal) for entry in new]
    assert event.get("readings", {}).keys() == {str(entry.literal) for entry in new if entry.reading}
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
