"""Templates are read before anybody looks at a page."""

from __future__ import annotations

from typing import Any, NoReturn

import pytest
from jinja2 import Environment
from tests.repairs.test_account import REPAIR, ROUND

from robomend.web import rendering


def test_no_template_is_compiled_when_a_page_is_looked_at(monkeypatch: pytest.MonkeyPatch) -> None:
    rendering._environment.cache_clear()
    rendering.prepare().join()

    def refused(*_: object, **__: object) -> NoReturn:
        raise AssertionError("a template is compiled")

    monkeypatch.setattr(Environment, "compile", refused)
    environment = rendering._environment()
    names = environment.list_templates()
    assert "robot.html" in names
    for name in names:
        environment.get_template(name)


def test_what_a_repair_that_ended_did_not_begin_waits_no_longer() -> None:
    macros: Any = rendering._environment().get_template("macros.html").module
    waits = [{"round": 1, "why": "for observers", "names": ["ok(scan)"], "from_ns": 1, "until_ns": 2}]
    step = {"text": "start_node(driver)", "index": 0, "cost": 4.0, "after": [], "state": "waiting"}
    known = {**REPAIR, "by": "robomend", "policy": "approve", "left_off": []}

    def shown(ending: str | None) -> str:
        rounds = [{**ROUND, "plan": [step], "ending": ending}]
        return str(macros.record({**known, "rounds": rounds, "waits": waits}))

    assert '<span class="badge waiting">waiting</span>' in shown(None)
    ended = shown("cancelled")
    assert '<span class="badge not-done">not done</span>' in ended
    assert "badge waiting" not in ended
    assert '</time>: <bdi class="name" dir="ltr">waiting for observers: ok(scan)' in ended


@pytest.mark.parametrize(
    ("said", "shown"),
    [
        ("a <b> explains not ok(c)", "a &lt;b&gt; explains not ok(c)"),
        ("חיישן 2 explains not on(חיישן 2)", "<bdi>חיישן 2</bdi> explains not on(<bdi>חיישן 2</bdi>)"),
        ('on("شمال"); right & left', "on(&#34;<bdi>شمال</bdi>&#34;); right &amp; left"),
    ],
)
def test_a_sentence_goes_from_left_to_right_whatever_is_named_in_it(said: str, shown: str) -> None:
    assert str(rendering.sentence(said)) == f'<bdi class="name" dir="ltr">{shown}</bdi>'
