"""Kinds of observers and actions that are named by a Python file, `checks.py:Class`, beside the agent's."""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Callable
from hashlib import sha256
from pathlib import Path
from typing import Any

from robomend_client.registry import BrokenKind, Registry, UnknownKind


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
