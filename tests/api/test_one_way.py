"""What one POST of an observation goes through, counted while it does: little, as docs/design.md promises.

A profile function sees every call of ours in every thread of a real service, and every value that comes back.
"""

from __future__ import annotations

import gc
import re
import threading
from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass
from pathlib import Path
from types import FrameType
from typing import Any

import pytest
from tests.api.conftest import Service, running

from robomend.observations.obs import Obs
from robomend.robots import diagnosing
from robomend.settings import Settings
from robomend_client.literals import Atom, Literal

ROOM = str(Path(diagnosing.__file__).parent)
DESIGN = Path(__file__).parents[2] / "docs" / "design.md"
SAID = "not ok(scan)"
LITERAL = Literal(Atom("ok", ("scan",)), False)
MOST_SHAPES = 4


class Watch:
    """A profile function: off, until a test wants to know."""

    def __init__(self) -> None:
        self.on = False
        self.entered: list[str] = []
        """Functions of diagnosing.py, each time another file of the room calls one."""
        self.made: list[object] = []
        """What functions returned that has the observation in it, until OBS had taken it in."""
        self._frames: list[FrameType] = []  # of coroutines; kept, as each is seen again when it goes on
        self._taken_in = False

    def begin(self) -> None:
        """Look at the next POST only."""
        self.entered, self.made, self._frames, self._taken_in = [], [], [], False
        self.on = True

    def __call__(self, frame: FrameType, event: str, value: object) -> None:
        if not self.on:
            return
        code = frame.f_code
        if event == "call" and code.co_filename == diagnosing.__file__:
            caller = frame.f_back and frame.f_back.f_code.co_filename
            if caller and caller.startswith(ROOM) and caller != code.co_filename:
                if not any(known is frame for known in self._frames):
                    self.entered.append(code.co_name)
                self._frames.append(frame)
        elif event == "return" and not self._taken_in:
            if code.co_name == "__init__":
                value = frame.f_locals.get("self")
            self.on = False  # looking calls functions, too
            if type(value).__module__.startswith("robomend") and carries(value):
                self.made.append(value)
            self.on, self._taken_in = True, code is Obs.update.__code__


@pytest.fixture(scope="module")
def watched(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Service, Watch]]:
    """A service with a robot, all threads of which are watched."""
    watch = Watch()
    threading.setprofile(watch)
    try:
        with running(Settings(port=0, data=tmp_path_factory.mktemp("data"))) as service:
            threading.setprofile(None)
            service.with_robot("r1")
            service.observe("ok(scan)")  # whatever is made once is there now
            service.diagnosis("r1", wait_s=20, after=0)
            yield service, watch
    finally:
        threading.setprofile(None)


def post(service: Service, watch: Watch, *sentences: str) -> None:
    """Post a batch, watched up to its answer."""
    watch.begin()
    answer = service.observe(*sentences)
    watch.on = False
    assert answer.status_code == 200, answer.text


def carries(value: object, depth: int = 6) -> bool:
    """Return whether the observation is in a value, as text or as a literal."""
    if value in (LITERAL, SAID):
        return True
    if depth == 0 or isinstance(value, type):
        return False
    inside: list[Any] = []
    if is_dataclass(value):
        inside = [getattr(value, field.name, None) for field in fields(value)]
    elif isinstance(value, Mapping):
        inside = [*value.keys(), *value.values()]
    elif isinstance(value, list | tuple | set | frozenset):
        inside = list(value)
    elif type(value).__module__.startswith("robomend"):
        inside = [getattr(value, name, None) for name in getattr(value, "__slots__", ())]
        inside += vars(value).values() if hasattr(value, "__dict__") else ()
    return any(carries(one, depth - 1) for one in inside)


def shape(value: object) -> str:
    """Return the name of a class of ours: of the base that a kind of it adds nothing but limits to."""
    return [one for one in type(value).__mro__ if one.__module__.startswith("robomend")][-1].__name__


def listed() -> list[tuple[str, ...]]:
    """Return the shapes of the page, in the order in which an observation takes them."""
    text = DESIGN.read_text(encoding="utf-8").partition("On this way an observation takes ")[2]
    return re.findall(r"`([A-Z]\w+)` \(|\(`([A-Z]\w+)`: |the (row) ", text.partition("\n\n")[0])


def test_the_diagnosing_code_is_entered_once_for_each_post(watched: tuple[Service, Watch]) -> None:
    service, watch = watched
    post(service, watch, SAID)
    assert watch.entered == ["write"], "news: the batch and its diagnosis are one write"
    post(service, watch, SAID)
    assert watch.entered == ["confirm"], "nothing new: the diagnosis stands"


def test_an_observation_takes_the_shapes_of_the_page_on_its_way_into_obs(
    watched: tuple[Service, Watch],
) -> None:
    service, watch = watched
    post(service, watch, "ok(scan)")
    there = gc.get_objects()  # held, so that nothing new has the address of something old
    before = {id(one) for one in there}
    post(service, watch, SAID)
    del there
    found = {
        shape(one) for one in watch.made if id(one) not in before and not isinstance(one, Literal | Atom)
    }
    *taken, row = ["".join(names) for names in listed()]
    assert row == "row"
    assert found == set(taken)
    assert len([*taken, row]) <= MOST_SHAPES
