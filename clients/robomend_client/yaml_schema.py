"""What a reader of a YAML file asks for, as JSON Schema: keys and bounds stand in the reader only.

An AskedSection answers like any Section, and notes each question. A reader that is given one leaves a schema
behind: of all that it asked for, whether the text has it or not. Where the reader goes one of two ways (a key
is a word here, a mapping there), it is given a text for each, and the schema has both.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from robomend_client.yaml_reader import Section
from robomend_client.yaml_tree import Mapping, Tree, read_tree

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
