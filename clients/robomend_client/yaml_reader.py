"""Reads a YAML file key by key, so that every complaint names file, line and key.

A Section is one mapping. Each key is asked for with its type and bounds; `finish` refuses what nobody asked
for, with the nearest known key, so that a typing error is an error and not a default.

So keys and bounds stand in the reader only, and the JSON Schema of a file is made from it. An AskedSection
answers like any Section, and notes each question. A reader that is given one leaves a schema behind: of
all that it asked for, whether the text has it or not. Where the reader goes one of two ways (a key is a
word here, a mapping there), it is given a text for each, and the schema has both.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from robomend_client.near import nearest
from robomend_client.yaml_tree import Mapping, RepeatedKey, Scalar, Sequence, Tree, YamlError, read_tree

LARGEST_FILE = 4 * 1024 * 1024

_NUMBER = re.compile(r"[+-]?([0-9]+(\.[0-9]*)?|\.[0-9]+)([eE][+-]?[0-9]+)?\Z")


class ConfigError(ValueError):
    """A configuration at fault; `str` reads `agent.yaml:12: processes.laser.command: …`."""

    def __init__(self, file: str, line: int | None, key: str, message: str) -> None:
        super().__init__(file, line, key, message)
        self.file = file
        self.line = line
        self.key = key
        self.message = message

    def __str__(self) -> str:
        place = self.file if self.line is None else f"{self.file}:{self.line}"
        return f"{place}: {self.key}: {self.message}" if self.key else f"{place}: {self.message}"


def read(file: Path) -> Section:
    """Return the mapping that `file` holds."""
    name = str(file)
    try:
        with file.open("rb") as stream:
            data = stream.read(LARGEST_FILE + 1)
    except OSError as error:
        raise ConfigError(name, None, "", f"cannot be read: {error.strerror}") from error
    if len(data) > LARGEST_FILE:
        raise ConfigError(name, None, "", f"larger than {LARGEST_FILE} bytes: not a configuration")
    try:
        return Section(read_tree(data.decode("utf-8-sig"), aliases=True), name, "")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        raise ConfigError(name, line, "", "not YAML: the file is not UTF-8 text") from error
    except RepeatedKey as error:
        raise ConfigError(name, error.line, ".".join(error.place), "is there twice") from error
    except YamlError as error:
        raise ConfigError(name, error.line, "", error.message) from error


class Section:
    """One mapping of the file."""

    def __init__(self, tree: Tree, file: str, place: str) -> None:
        self._file = file
        self._place = place
        self._asked: set[str] = set()
        if isinstance(tree, Scalar) and tree.empty:  # `scan:` with nothing behind it: all defaults
            tree = Mapping({}, tree.line)
        if not isinstance(tree, Mapping):
            raise ConfigError(file, tree.line, place, "must be a mapping (key: value)")
        self._tree = tree
        self._values = tree.items

    def __contains__(self, key: str) -> bool:
        return key in self._values

    def error(self, key: str, message: str) -> ConfigError:
        """Return a complaint about `key`."""
        return ConfigError(self._file, self._values.get(key, self._tree).line, self._name(key), message)

    def explain(self, **keys: str) -> None:
        """Say what keys are for, in seconds, bytes or whatever they are; editors show it."""

    def expect(self, keys: Iterable[str]) -> None:
        """Note that these are keys, before any is read: none is then taken for another's misspelling."""
        self._asked.update(keys)

    def missing(self, key: str, message: str, *others: str) -> ConfigError:
        """Return a complaint that `key` is needed, or one of the others: about its misspelling, if that is
        what is there.
        """
        unknown = [name for name in self._values if name not in self._asked]
        for wanted in (key, *others):
            if (near := nearest(wanted, unknown)) is not None:
                return self.error(near, f"is no key here; did you mean {wanted}?")
        return self.error(key, message)

    def text(self, key: str, default: str | None = None) -> str:
        tree = self._take(key)
        if tree is None:
            if default is None:
                raise self.missing(key, "is missing")
            return default
        return self._scalar(tree, key)

    def optional(self, key: str) -> str | None:
        tree = self._take(key)
        return None if tree is None else self._scalar(tree, key)

    def choice(self, key: str, allowed: tuple[str, ...], default: str, beside: str = "") -> str:
        """Return one of a few words; `beside` is said of what the key may be besides."""
        value = self.text(key, default)
        if value not in allowed:
            raise self.error(key, f"must be one of {', '.join(allowed)}{beside}, not {value!r}")
        return value

    def flag(self, key: str, default: bool) -> bool:
        value = self.text(key, "true" if default else "false").lower()
        if value not in ("true", "false", "yes", "no"):
            raise self.error(key, f"must be true or false, not {value!r}")
        return value in ("true", "yes")

    def number(self, key: str, default: float, least: float = 0.0, most: float = 1e9) -> float:
        value = self.text(key, repr(default))
        if not _NUMBER.match(value):
            raise self.error(key, f"must be a number, not {value!r}")
        number = float(value)
        if not least <= number <= most:
            raise self.error(key, f"must be from {least:g} to {most:g}, not {value}")
        return number

    def whole(self, key: str, default: int, least: int = 0, most: int = 10**9) -> int:
        number = self.number(key, default, least, most)
        if number != int(number):
            raise self.error(key, f"must be a whole number, not {number:g}")
        return int(number)

    def texts(self, key: str, needed: str = "") -> tuple[str, ...]:
        """Return a list of texts; empty when the key is not there.

        Args:
            needed: the complaint where there must be at least one, and it is not empty.
        """
        if needed and (not (texts := self.texts(key)) or not texts[0]):
            raise self.missing(key, needed)
        tree = self._take(key)
        if tree is None:
            return ()
        if not isinstance(tree, Sequence):
            raise self.error(key, "must be a list, e.g. [a, b]")
        return tuple(self._scalar(item, key) for item in tree.items)

    def section(self, key: str) -> Section:
        """Return the mapping under `key`; an empty one when it is not there."""
        return self._below(key, self._take(key) or Mapping({}, self._tree.line))

    def is_section(self, key: str) -> bool:
        return isinstance(self._values.get(key), Mapping)

    def sections(self, key: str) -> Iterator[tuple[str, Section]]:
        """Yield name and mapping of each entry under `key`."""
        entries = self.section(key)
        for name in entries._values:
            yield name, entries.section(name)

    def names(self) -> tuple[str, ...]:
        """Return the keys that are there."""
        return tuple(self._values)

    def words(self) -> dict[str, str]:
        """Return all of this mapping as texts (environment variables)."""
        return {key: self.text(key) for key in self._values}

    def finish(self) -> None:
        """Refuse the keys that nobody asked for."""
        for key in self._values:
            if key not in self._asked:
                near = nearest(key, self._asked)
                hint = f"; did you mean {near}?" if near else f"; known are {', '.join(sorted(self._asked))}"
                raise self.error(key, f"is no key here{hint}")

    def _below(self, key: str, tree: Tree) -> Section:
        return Section(tree, self._file, self._name(key))

    def _take(self, key: str) -> Tree | None:
        self._asked.add(key)
        return self._values.get(key)

    def _scalar(self, tree: Tree, key: str) -> str:
        if not isinstance(tree, Scalar):
            message = "must be one value, not a list or mapping"
        elif tree.empty:
            message = "has no value"
        elif "\0" in tree.text:
            message = "holds a NUL, which no text here may"
        else:
            return tree.text
        raise ConfigError(self._file, tree.line, self._name(key), message)

    def _name(self, key: str) -> str:
        return ".".join(name for name in (self._place, key) if name)


Schema = dict[str, Any]

DRAFT = "https://json-schema.org/draft/2020-12/schema"

TEXT: Schema = {"type": ["string", "number", "boolean"]}
"""A scalar is the text that was written, whatever YAML takes it for."""

FLAG: Schema = {"enum": [True, False, "yes", "no"]}
ANY_NAME = "*"
"""What a mapping that seems to have every key says where it is asked which it has."""

FAR = 1e9
"""A bound this far out is there for the arithmetic, not for the person who writes."""


class AskedSection(Section):
    """One mapping of a file, which notes what is asked of it in `schema`."""

    def __init__(self, tree: Tree, place: str, schema: Schema, *, has_all: bool = False) -> None:
        """
        Args:
            schema: of a mapping; what is asked is added to it.
            has_all: say that each key is there, so that a reader asks for it by its own type.
        """
        super().__init__(tree, "schema", place)
        self.schema = schema
        self._has_all = has_all
        self._explained: dict[str, str] = {}
        schema.setdefault("type", ["object", "null"])
        schema.setdefault("properties", {})

    def __contains__(self, key: str) -> bool:
        return self._has_all or super().__contains__(key)

    def explain(self, **keys: str) -> None:
        self._explained |= keys

    def text(self, key: str, default: str | None = None) -> str:
        self._note(key, _with_default(TEXT, default))
        if default is None:
            self._require(key)
        return super().text(key, "" if self._has_all else default)

    def optional(self, key: str) -> str | None:
        self._note(key, TEXT)
        return super().optional(key)

    def choice(self, key: str, allowed: tuple[str, ...], default: str, beside: str = "") -> str:
        self._note(key, {"enum": list(allowed), "default": default})
        return super().text(key, default)

    def flag(self, key: str, default: bool) -> bool:
        self._note(key, {**FLAG, "default": default})
        return default

    def number(self, key: str, default: float, least: float = 0.0, most: float = 1e9) -> float:
        self._note(key, _number("number", default, least, most))
        return default

    def whole(self, key: str, default: int, least: int = 0, most: int = 10**9) -> int:
        self._note(key, _number("integer", default, least, most))
        return default

    def texts(self, key: str, needed: str = "") -> tuple[str, ...]:
        if needed:
            self._require(key)
        self._note(key, {"type": "array", "items": TEXT, **({"minItems": 1} if needed else {})})
        return super().texts(key)

    def words(self) -> dict[str, str]:
        self.schema["additionalProperties"] = TEXT
        return super().words()

    def sections(self, key: str) -> Iterator[tuple[str, Section]]:
        entries = self.section(key)
        assert isinstance(entries, AskedSection)
        entry = entries.schema.setdefault("additionalProperties", {})
        for name in entries.names():
            tree = entries._values.get(name, Mapping({}, 1))
            yield name, AskedSection(tree, name, entry, has_all=self._has_all)

    def names(self) -> tuple[str, ...]:
        return (ANY_NAME,) if self._has_all else super().names()

    def finish(self) -> None:
        self.schema.setdefault("additionalProperties", False)

    def _below(self, key: str, tree: Tree) -> Section:
        schema = self._note(key, {"type": ["object", "null"], "properties": {}})
        return AskedSection(tree, self._name(key), schema, has_all=self._has_all)

    def _require(self, key: str) -> None:
        required = self.schema.setdefault("required", [])
        if key not in required:
            required.append(key)

    def _note(self, key: str, schema: Schema) -> Schema:
        """Note what a key may be, beside what was noted before; return the schema that stands for it."""
        if key == ANY_NAME:
            self.schema["additionalProperties"] = schema
            return schema
        properties = self.schema["properties"]
        known = properties.get(key)
        said = {"description": self._explained[key]} if key in self._explained else {}
        if known is None:
            properties[key] = {**said, **schema}
            return properties[key]  # type: ignore[no-any-return]  # what was put there
        kinds = known.get("anyOf", [known])
        for kind in kinds:
            if kind in (schema, {**said, **schema}) or ("properties" in kind and "properties" in schema):
                return kind  # type: ignore[no-any-return]  # as above
        known.pop("description", None)
        properties[key] = {**said, "anyOf": [*kinds, dict(schema)]}
        return properties[key]["anyOf"][-1]  # type: ignore[no-any-return]  # as above


def asked(text: str, schema: Schema) -> AskedSection:
    """Return the mapping of a text, which adds to a schema what is asked of it."""
    return AskedSection(read_tree(text), "", schema)


def asked_for_all(schema: Schema) -> AskedSection:
    """Return a mapping that seems to have every key, which adds to a schema what is asked of it."""
    return AskedSection(Mapping({}, 1), "", schema, has_all=True)


def _with_default(schema: Schema, default: str | None) -> Schema:
    return {**schema, "default": default} if default else schema


def _number(kind: str, default: float, least: float, most: float) -> Schema:
    schema: Schema = {"type": kind, "default": default}
    if least > -FAR:
        schema["minimum"] = least
    if most < FAR:
        schema["maximum"] = most
    return schema
