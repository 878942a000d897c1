"""docs/models.md names every key, sort, relation and predicate that there is."""

from __future__ import annotations

from pathlib import Path

import pytest

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


@pytest.mark.parametrize(
    "key",
    sorted(
        {
            *MODEL_KEYS,
            *HARDWARE_KEYS,
            *NODE_KEYS,
            *TOPIC_KEYS,
            *PROPERTY_KEYS,
            *REMEDY_KEYS,
            *VALUE_KEYS,
            *FUNCTION_KEYS,
            *VARIANT_KEYS,
            *KEYS,
        }
    ),
)
def test_every_key_is_documented(key: str) -> None:
    assert f"`{key}`" in PAGE


@pytest.mark.parametrize("name", sorted({*EMPTY.relations, *EMPTY.predicates}))
def test_every_relation_and_predicate_is_documented(name: str) -> None:
    assert f"`{name}(" in PAGE


@pytest.mark.parametrize("sort", sorted(set(EMPTY.sorts) - {"node_resources", "channel_readings"}))
def test_every_sort_is_documented(sort: str) -> None:
    assert f"`{sort}`" in PAGE
