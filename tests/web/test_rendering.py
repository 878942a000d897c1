"""Templates are read before anybody looks at a page."""

from __future__ import annotations

from typing import NoReturn

import pytest
from jinja2 import Environment

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
