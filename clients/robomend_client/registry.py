"""Parts by name: those that come with robomend, and those that other distributions add by entry point.

    ENGINES = Registry[EngineClass](
        "engine", "robomend.engines", {"sat": "robomend.diagnosis.sat:SatEngine"},
        unknown=OptionRefused, broken=SolverError,
    )
    ENGINES.names()       # ("sat", "mine"): ours in the order of the table, then the others'
    ENGINES.load("mine")  # imports the module that is asked for, no other

Another distribution adds one by a line in its pyproject.toml; our own names cannot be taken over:

    [project.entry-points."robomend.engines"]
    mine = "my_package:MyEngine"
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from importlib import import_module
from typing import TYPE_CHECKING, Generic, TypeVar, cast

from robomend_client.near import did_you_mean

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint


import importlib.util
import sys
from hashlib import sha256
from pathlib import Path
from typing import Any

T = TypeVar("T")


class UnknownKind(LookupError):
    """No part has this name."""


class BrokenKind(ImportError):
    """The code of a part cannot be loaded."""


class Registry(Generic[T]):
    """The parts of one kind. Nothing is imported before it is asked for by its name."""

    def __init__(
        self,
        what: str,
        group: str | None,
        built_in: Mapping[str, str],
        *,
        unknown: Callable[[str], Exception] = UnknownKind,
        broken: Callable[[str], Exception] = BrokenKind,
        beside: tuple[str, ...] = (),
    ) -> None:
        """Register what comes with us.

        Args:
            what: one part of this kind, in the words of an error: `engine`.
            group: the entry points of this group are parts, too; None: others cannot add any.
            built_in: name -> `module:attribute`.
            unknown: makes the error for a name that no part has.
            broken: makes the error for a part that cannot be imported.
            beside: names of no parts, which may be written where those of parts are.
        """
        self.what = what
        self.group = group
        self.built_in = dict(built_in)
        self._unknown = unknown
        self._broken = broken
        self._beside = beside
        self._loaded: dict[str, T] = {}

    def names(self) -> tuple[str, ...]:
        """Return the names that `load` knows: ours, then those of others in alphabetical order."""
        return (*self.built_in, *sorted(self._others()))

    def check(self, name: str) -> None:
        """Raise `unknown`, with all names there are, unless a part has this name; nothing is imported."""
        self._entry(name)

    def load(self, name: str) -> T:
        """Return what the name stands for; its module is imported the first time.

        Raises:
            unknown: no part has this name.
            broken: its module cannot be imported, or has nothing of that name.
        """
        if name not in self._loaded:
            entry = self._entry(name)
            value = entry if isinstance(entry, str) else entry.value
            try:
                self._loaded[name] = cast(T, _found(value) if isinstance(entry, str) else entry.load())
            except Exception as error:  # the module of a third party may raise anything
                what = f"{self.what} {name!r} ({value})"
                raise self._broken(f"{what} could not be loaded: {error}") from error
        return self._loaded[name]

    def _entry(self, name: str) -> EntryPoint | str:
        if name in self.built_in:
            return self.built_in[name]
        others = self._others()
        if name not in others:
            names = (*self._beside, *self.names())
            choice = f"choose one of {', '.join(names)}{did_you_mean(name, names)}"
            raise self._unknown(f"no {self.what} is named {name!r}: {choice}")
        return others[name]

    def _others(self) -> dict[str, EntryPoint]:
        """Return the parts of other distributions; of two with one name, that of the first on the path."""
        if self.group is None:
            return {}
        from importlib.metadata import entry_points  # takes longer than all that a worker needs besides

        points = reversed(tuple(entry_points(group=self.group)))
        return {point.name: point for point in points if point.name not in self.built_in}


def _found(value: str) -> object:
    """Return what `module:attribute` names."""
    module, _, attribute = value.partition(":")
    return getattr(import_module(module), attribute)


# --- kinds of observers and actions that are named by a Python file, `checks.py:Class`, beside the agent's.


def load_of_file(kinds: Registry[Callable[..., Any]], kind: str, base: Path) -> Callable[..., Any]:
    """Return what `FILE.py:NAME` stands for, relative to `base`, or else what is registered by the name.

    Raises:
        UnknownKind, BrokenKind: there is none, or it cannot be imported.
    """
    file, colon, attribute = kind.rpartition(":")
    return load_file(base / file, attribute) if colon and file.endswith(".py") else kinds.load(kind)


def load_file(file: Path, attribute: str) -> Callable[..., Any]:
    """Return a class or function of a Python file; the file is run once, however many name it."""
    name = f"robomend_file_{sha256(str(file.resolve()).encode()).hexdigest()[:16]}"
    module = sys.modules.get(name)
    if module is None:
        if not file.is_file():
            raise UnknownKind(f"there is no file {file}")
        spec = importlib.util.spec_from_file_location(name, file)
        assert spec is not None
        assert spec.loader is not None
        module = sys.modules[name] = importlib.util.module_from_spec(spec)
        try:
            spec.loader.exec_module(module)
        except Exception as error:  # anybody's file may raise anything
            del sys.modules[name]
            raise BrokenKind(f"{file} cannot be run: {type(error).__name__}: {error}") from error
    found = getattr(module, attribute, None)
    if not callable(found):
        raise UnknownKind(f"{file} has no class or function {attribute!r}")
    return found  # type: ignore[no-any-return]  # whatever it is, it can be called
