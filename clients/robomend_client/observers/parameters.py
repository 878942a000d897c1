"""The parameters of an observer, as keys of a file: read off the signature of whoever makes it.

    def __init__(self, atom: str, source: str, band: Band, readings: Readings | None = None)

`atom` and `source` are keys, and so is each field of `Band` and `Readings`: a parameter whose type is a
dataclass is spread. `**rest` stands for the parameters of the base class. Types that can be written are
numbers, texts, flags, lists of texts, mappings from text to text, and mappings from text to a dataclass.

What the docstrings of both say under `Args:` and `Attributes:`, editors show at the keys (docstrings.py).

A dataclass refuses what is impossible with a ValueError that begins with the name of the field, so that the
complaint has the line of the key. Its PRESETS are defaults by the name of a preset.
"""

from __future__ import annotations

import inspect
import types
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import MISSING, fields, is_dataclass
from typing import Any, Union, get_args, get_origin, get_type_hints

from robomend_client.yaml_reader import ConfigError, Section

LARGEST = 1e15


class UnreadableParameter(TypeError):
    """A parameter has no type, or one that cannot be written in a file: the fault of the observer's
    author.
    """


def read_arguments(
    section: Section,
    make: Callable[..., Any],
    preset: str | None,
    name: str,
    given: frozenset[str] = frozenset(),
) -> dict[str, Any]:
    """Return the arguments for `make` that a section has.

    Args:
        section: its keys are taken; the caller finishes it.
        make: a class or a function.
        preset: whose defaults count.
        name: the entry's name; it stands for `atom`, or else for the first parameter, where that is left out.
        given: parameters that the caller gives itself.

    Raises:
        ConfigError: a value is missing or wrong.
        UnreadableParameter: `make` has a parameter that cannot be read.
    """
    found: dict[str, Any] = {}
    presets = [p for kind in spread_dataclasses(make) if (p := getattr(kind, "PRESETS", None))]
    if preset is not None and not any(preset in p for p in presets):
        known = sorted({name for p in presets for name in p})
        raise section.error("preset", f"must be one of {', '.join(known)}" if known else "this kind has none")
    defaults = {key: value for p in presets for key, value in p.get(preset, {}).items()} if preset else {}
    parameters = list(parameters_of(make))
    names = [parameter.name for parameter, _ in parameters if parameter.name not in given]
    named = "atom" if "atom" in names else next(iter(names), "")
    spread = (field.name for kind in spread_dataclasses(make) for field in fields(kind))
    section.expect((*names, *spread))
    for parameter, kind in parameters:
        if parameter.name in given:
            continue
        default = defaults.get(parameter.name, parameter.default)
        if dataclass := dataclass_of(kind):
            found[parameter.name] = read_dataclass(section, dataclass, defaults)
        elif parameter.name == named and named not in section and (kind is str or is_list(kind)):
            section.optional(parameter.name)  # it is a key, too
            found[parameter.name] = (name,) if is_list(kind) else name
        else:
            found[parameter.name] = read_value(section, parameter.name, kind, default)
    return found


def read_dataclass(section: Section, kind: type, defaults: Mapping[str, Any] | None = None) -> Any:
    """Return an instance, its fields read from the section's keys."""
    hints = get_type_hints(kind)
    values = {}
    for field in fields(kind):
        default: Any = inspect.Parameter.empty if field.default is MISSING else field.default
        default = (defaults or {}).get(field.name, default)
        values[field.name] = read_value(section, field.name, hints[field.name], default)
    return made(section, kind, **values)


def made(section: Section, make: Callable[..., Any], **arguments: Any) -> Any:
    """Return make(**arguments); what it refuses is a complaint about the key that it names first."""
    try:
        return make(**arguments)
    except ValueError as error:
        if isinstance(error, ConfigError):
            raise
        key = str(error).split(" ", 1)[0].rstrip(":")
        if key in arguments and key not in section:  # it is what is not there that is refused
            others = (name for name in arguments if name not in section)
            raise section.missing(key, str(error), *others) from error
        raise section.error(key if key in arguments or key in section else "", str(error)) from error


def read_value(section: Section, key: str, kind: Any, default: Any) -> Any:
    """Return the value of one key, in the type that is asked for."""
    kinds = alternatives(kind)
    if key not in section and type(None) in kinds:
        section.optional(key)
        return None if default is inspect.Parameter.empty else default
    kind = next(k for k in kinds if k is not type(None))
    missing = default is inspect.Parameter.empty
    if missing and key not in section:
        section.optional(key)
        raise section.missing(key, "is missing")
    if kind is bool:
        return section.flag(key, bool(default is True))
    if kind is int:
        return section.whole(key, 0 if missing or default is None else default, least=-(10**9))
    if kind is float:
        return section.number(
            key, 0.0 if missing or default is None else default, least=-LARGEST, most=LARGEST
        )
    if kind is str:
        return section.text(key, "" if missing else default)
    if is_list(kind):
        return section.texts(key) if key in section else tuple(section.texts(key)) or tuple(default)
    if _is_mapping(kind):
        return _read_mapping(section, key, kind)
    raise UnreadableParameter(f"{key} has the type {kind!r}, which no file can hold")


def _read_mapping(section: Section, key: str, kind: Any) -> dict[str, Any]:
    _, value = get_args(kind)
    if value is str:
        return section.section(key).words()
    if is_list(value):
        entries = section.section(key)
        return {name: entries.texts(name) for name in entries.names()}
    if not is_dataclass(value):
        raise UnreadableParameter(f"{key} has the type {kind!r}, which no file can hold")
    found = {}
    for name, entry in section.sections(key):
        found[name] = read_dataclass(entry, value)  # type: ignore[arg-type]  # is_dataclass knows instances, too
        entry.finish()
    return found


def parameters_of(make: Callable[..., Any]) -> Iterator[tuple[inspect.Parameter, Any]]:
    """Yield the parameters and their types; those of the base classes, too, where `**rest` hands them on."""
    makers = [vars(c)["__init__"] for c in _bases(make) if "__init__" in vars(c)] or [make]
    seen: set[str] = {"self"}
    for maker in makers:
        hints = get_type_hints(maker)
        more = False
        for parameter in inspect.signature(maker).parameters.values():
            if parameter.kind is parameter.VAR_KEYWORD:
                more = True
            elif parameter.name not in seen and parameter.kind is not parameter.VAR_POSITIONAL:
                seen.add(parameter.name)
                if parameter.name not in hints:
                    raise UnreadableParameter(f"the parameter {parameter.name} needs a type, e.g. float")
                yield parameter, hints[parameter.name]
        if not more:
            return


def _bases(make: Callable[..., Any]) -> tuple[type, ...]:
    return make.__mro__[:-1] if inspect.isclass(make) else ()


def spread_dataclasses(make: Callable[..., Any]) -> list[type]:
    return [found for _, kind in parameters_of(make) if (found := dataclass_of(kind)) is not None]


def dataclass_of(kind: Any) -> type | None:
    return next((k for k in alternatives(kind) if inspect.isclass(k) and is_dataclass(k)), None)


def alternatives(kind: Any) -> tuple[Any, ...]:
    return get_args(kind) if get_origin(kind) in (Union, types.UnionType) else (kind,)


def is_list(kind: Any) -> bool:
    return get_origin(kind) in (tuple, list, Sequence, Iterable)


def _is_mapping(kind: Any) -> bool:
    return get_origin(kind) in (dict, Mapping)
