"""Parts by name: ours, and those of other distributions."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from tests.distributions import install

from robomend_client.registry import Registry

CODE = """\
class Mine:
    class Inner: ...
def ours_in_disguise(): ...
"""

GROUP = "robomend_tests.parts"


@pytest.fixture
def parts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Registry[Callable[[], object]]:
    """Two parts of ours, and a distribution that adds four and tries to take one of ours over."""
    names = {"mine": "Mine", "inner": "Mine.Inner", "ours": "ours_in_disguise", "gone": "NoSuchThing"}
    monkeypatch.syspath_prepend(str(install(tmp_path / "good", "good_parts", CODE, {GROUP: names})))
    explodes = install(tmp_path / "bad", "bad_parts", "1 / 0", {GROUP: {"explodes": "Part"}})
    monkeypatch.syspath_prepend(str(explodes))
    ours = {"ours": "fractions:Fraction", "lost": "robomend_client.nowhere:Part"}
    return Registry("part", GROUP, ours, unknown=KeyError, broken=OSError)


def test_an_unknown_name_is_refused_with_all_there_are_and_the_nearest(
    parts: Registry[Callable[[], object]],
) -> None:
    listed = r"no part is named 'mime': choose one of ours, lost, .*, mine; did you mean 'mine'\?"
    for refuses in (parts.check, parts.load):
        with pytest.raises(KeyError, match=listed):
            refuses("mime")
    with pytest.raises(KeyError, match=r"inner, mine\W$"):
        parts.check("zzz")


@pytest.mark.parametrize("name", ["gone", "explodes", "lost"])
def test_what_cannot_be_imported_is_named_with_its_place(
    name: str, parts: Registry[Callable[[], object]]
) -> None:
    parts.check(name)
    with pytest.raises(OSError, match=rf"part '{name}' \(.*\) could not be loaded: "):
        parts.load(name)


def test_of_two_with_one_name_the_first_on_the_path_counts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for folder in ("late", "early"):
        code = f"PART = {folder!r}"
        monkeypatch.syspath_prepend(
            str(install(tmp_path / folder, f"{folder}_parts", code, {GROUP: {"same": "PART"}}))
        )
    assert Registry[str]("part", GROUP, {}).load("same") == "early"
