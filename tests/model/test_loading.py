"""Which format a text is in: it decides by itself, unless somebody says so."""

from __future__ import annotations

from itertools import permutations

import pytest

from robomend.errors import ModelError
from robomend.model.loading import FORMATS, load_text

TEXTS = {
    "component": "robomend: 1\nnodes: [a]\n",
    "five-key": 'ab: AB\nnab: NAB\nneg_prefix: not_\nprops: [ok(t)]\nrules: ["NAB(a) -> ok(t)"]\n',
    "bench": "# a comment\n\n z = NOT(a)\nINPUT(a)\nOUTPUT(z)\n",
}


@pytest.mark.parametrize("format", FORMATS)
def test_a_text_says_by_itself_what_it_is_and_may_be_told(format: str) -> None:
    assert load_text(TEXTS[format]).format == format
    assert load_text(TEXTS[format], format=format).format == format


@pytest.mark.parametrize(("format", "other"), [*permutations(FORMATS, 2)])
def test_what_it_is_said_to_be_it_must_be(format: str, other: str) -> None:
    with pytest.raises(ModelError):
        load_text(TEXTS[format], format=other)


def test_what_is_no_model_is_told_what_models_begin_with() -> None:
    with pytest.raises(ModelError, match=r"begins with `robomend: 1`.*INPUT"):
        load_text("a: 1\n", file="x.yaml")
    with pytest.raises(ModelError, match="begins with `robomend: 1`"):  # not a five-key model with odd keys
        load_text("nodes: {n: {}}\nrules: []\n")
    with pytest.raises(ModelError, match="no model format is named `yaml`; there are component, five-key"):
        load_text("robomend: 1\n", format="yaml")
