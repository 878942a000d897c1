"""docs/models.md names every key, sort, relation and predicate that there is."""

from __future__ import annotations

from pathlib import Path

from robomend.model.compiling import vocabulary_of
from robomend.model.component_yaml import (
    FUNCTION_KEYS,
    HARDWARE_KEYS,
    MODEL_KEYS,
    NODE_KEYS,
    PROPERTY_KEYS,
    REMEDY_KEYS,
    TOPIC_KEYS,
    VALUE_KEYS,
    VARIANT_KEYS,
)
from robomend.model.components import ComponentModel
from robomend.model.five_key import KEYS

PAGE = (Path(__file__).parents[2] / "docs" / "models.md").read_text(encoding="utf-8")
EMPTY = vocabulary_of(ComponentModel("r", {}, {}, {}))


def test_every_key_sort_relation_and_predicate_is_documented() -> None:
    of_things = {*HARDWARE_KEYS, *NODE_KEYS, *TOPIC_KEYS, *PROPERTY_KEYS, *VALUE_KEYS}
    words = {*MODEL_KEYS, *of_things, *REMEDY_KEYS, *FUNCTION_KEYS, *VARIANT_KEYS, *KEYS}
    words |= set(EMPTY.sorts) - {"node_resources", "channel_readings"}
    told = {f"`{word}`" for word in words} | {f"`{name}(" for name in {*EMPTY.relations, *EMPTY.predicates}}
    assert {one for one in told if one not in PAGE} == set()
