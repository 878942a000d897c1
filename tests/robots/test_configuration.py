"""A robot's settings are one list: what HTTP takes, what the service reads of it, what docs/http.md says."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Literal, get_args, get_origin

import pytest
from pydantic import BaseModel
from pydantic.fields import FieldInfo

from robomend.api.schemas.robots import BoardBody, ExpectedCurrentBody, RobotBody
from robomend.robots.configuration import RobotConfig

ROOT = Path(__file__).resolve().parents[2]
SECTION = (
    (ROOT / "docs" / "http.md")
    .read_text(encoding="utf-8")
    .partition("\n## A robot\n")[2]
    .partition("\n## ")[0]
)
ROWS = re.findall(r"^\| (`[^|]+`) \|([^|]*)\| (.+) \|$", SECTION, re.MULTILINE)
BOARD = {"host": "127.0.0.1", "port": 1}
REQUIRED: dict[type[BaseModel], dict[str, Any]] = {
    RobotBody: {"model": "m"},
    BoardBody: BOARD,
    ExpectedCurrentBody: {"current_a": 1.0, "tolerance_a": 1.0},
}


def another(info: FieldInfo) -> Any:
    """Return a value that a field may have and that is not its default."""
    options = get_args(info.annotation) if type(None) in get_args(info.annotation) else (info.annotation,)
    kind = next(option for option in options if option is not type(None))
    if get_origin(kind) is Literal:
        return next(value for value in get_args(kind) if value != info.default)
    if get_origin(kind) is list:
        return [7] if info.default and isinstance(info.default[0], int) else ["x"]
    if get_origin(kind) is dict:
        value = get_args(kind)[1]
        return {"1": REQUIRED.get(value, {})}
    return {str: "another", int: 17, float: 17.5, bool: not info.default}[kind]


def held(annotation: Any) -> type[BaseModel] | None:
    """Return the model of which an annotation speaks, if it does."""
    found = [kind for kind in (annotation, *get_args(annotation)) if isinstance(kind, type)]
    return next((kind for kind in found if issubclass(kind, BaseModel)), None)


def settings(kind: type[BaseModel] = RobotBody) -> Iterator[tuple[tuple[str, ...], dict[str, Any]]]:
    """Yield each setting, as a path of names, and a body that sets it, and nothing else without need."""
    for name, info in kind.model_fields.items():
        inner = held(info.annotation)
        if inner is None or get_origin(info.annotation) in {list, dict}:
            yield (name,), {**REQUIRED.get(kind, {}), name: another(info)}
        else:
            for path, body in settings(inner):
                yield (name, *path), {**REQUIRED.get(kind, {}), name: body}


SETTINGS = dict(settings())


def test_what_is_not_set_is_for_the_service_what_http_says_it_is() -> None:
    body = RobotBody(model="m", board=BoardBody(**BOARD)).model_dump()  # type: ignore[arg-type]  # by name
    assert RobotConfig.from_json("r", body) == RobotConfig.from_json("r", {"model": "m", "board": BOARD})
    assert RobotConfig.from_json("r", {"model": "m"}) == RobotConfig("r", "m")


@pytest.mark.parametrize("path", SETTINGS, ids=".".join)
def test_the_service_reads_each_setting_that_http_takes(path: tuple[str, ...]) -> None:
    without = {"model": "m", **({"board": BOARD} if path[0] == "board" else {})}
    assert RobotConfig.from_json("r", SETTINGS[path]) != RobotConfig.from_json("r", without)


@pytest.mark.parametrize("path", SETTINGS, ids=".".join)
def test_each_setting_and_its_default_is_on_the_page(path: tuple[str, ...]) -> None:
    (row,) = (row for row in ROWS if f"`{path[0]}`" in row[0] or f"`{path[0]}." in row[0])
    names = re.findall(r"`([\w.]+)`", row[0])
    if len(path) == 1:
        assert path[0] in names
        default = RobotBody.model_fields[path[0]].get_default(call_default_factory=True)
        shown = dict(zip(names, re.findall(r"\[.*?\]|\{.*?\}|[^,\s]+", row[1]), strict=False))
        if path != ("model",):  # it has none
            told = shown[path[0]].strip("`")
            assert told == default or json.loads(told) == default
        one = held(RobotBody.model_fields[path[0]].annotation)
        assert {name for name in (one.model_fields if one else ()) if f"`{name}`" not in row[2]} == set()
    else:
        assert ".".join(path) in names or re.search(rf"\b{path[-1]}\b", row[2])


def test_the_page_has_no_other_setting() -> None:
    named = {name.partition(".")[0] for row in ROWS for name in re.findall(r"`([\w.]+)`", row[0])}
    assert named == RobotBody.model_fields.keys()
