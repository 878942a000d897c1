"""Templates are read in a thread, when somebody looks at a page that has them."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from typing import Any, NoReturn

import pytest
from jinja2 import Environment, nodes
from jinja2.meta import find_referenced_templates
from tests.api.conftest import Service
from tests.repairs.test_account import REPAIR, ROUND

from robomend.web import rendering

PAGES = sorted(path.name for path in (rendering.HERE / "templates").glob("*.html"))


@pytest.fixture
def _nothing_read(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setattr(rendering, "_known", set())
    rendering._environment.cache_clear()
    yield
    rendering._environment.cache_clear()


@pytest.mark.usefixtures("_nothing_read")
@pytest.mark.parametrize("page", PAGES)
def test_no_template_is_compiled_when_a_page_is_made(page: str, monkeypatch: pytest.MonkeyPatch) -> None:
    rendering.read(page)
    assert rendering.known(page)

    def refused(*_: object, **__: object) -> NoReturn:
        raise AssertionError("a template is compiled")

    monkeypatch.setattr(Environment, "compile", refused)
    environment, left, seen = rendering._environment(), [page], set()
    while left:
        name = left.pop()
        environment.get_template(name)
        seen.add(name)
        parsed = environment.parse((rendering.HERE / "templates" / name).read_text(encoding="utf-8"))
        whole = [one for one in find_referenced_templates(parsed) if one in environment.list_templates()]
        left += [one for one in whole if one not in seen]  # a part by its name is one of the page's own
        if any(node.name == "fleet_row" for node in parsed.find_all(nodes.Name)):
            left.append("fleet_row.html")


@pytest.mark.usefixtures("_nothing_read")
def test_a_page_has_its_templates_read_once_and_in_a_thread(
    service: Service, monkeypatch: pytest.MonkeyPatch
) -> None:
    readers = []

    def watched(template: str) -> None:
        readers.append((template, threading.get_ident()))
        rendering._known.add(template)

    async def on_the_loop() -> int:
        return threading.get_ident()

    monkeypatch.setattr("robomend.api.page_route.read", watched)
    for _ in range(2):
        assert service.http.get("/").status_code == 200
    [(template, thread)] = readers
    assert template == "fleet.html"
    assert thread != service.run(on_the_loop())


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
