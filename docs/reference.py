"""The reference pages of the site, made from the code while the site is built (docs/mkdocs_hooks.py).

They are not in the repository: what a command, a route or a key is, only the code says.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterable, Iterator
from http import HTTPStatus
from typing import Any

import click

Row = Iterable[object]

MODEL_SECTIONS = ("hardware", "nodes", "topics", "properties", "values")


def pages() -> dict[str, str]:
    """Return the Markdown of each page by its name."""
    return {
        "reference/commands.md": commands_page(),
        "reference/files.md": files_page(),
        "reference/http.md": http_page(),
        "reference/observers.md": observers_page(),
        "reference/settings.md": settings_page(),
        "reference/errors.md": errors_page(),
        "reference/events.md": events_page(),
    }


def table(head: Row, rows: Iterable[Row]) -> str:
    """Return a table; what would end a cell is escaped."""
    heads = [str(cell) for cell in head]
    lines = [heads, ["---"] * len(heads), *([_cell(cell) for cell in row] for row in rows)]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines) + "\n"


def _cell(value: object) -> str:
    return re.sub(r"\s+", " ", str(value)).replace("|", "\\|").strip()


def _code(value: object) -> str:
    return f"`{value}`" if str(value) else ""


# --- commands


def commands_page() -> str:
    from robomend.cli.commands import cli

    parts = ["# Commands", "Every command with its arguments and options, as `--help` has them."]
    for words, command in walk(cli, ("robomend",)):
        parts.append(f"## {' '.join(words)}")
        parts.append(_help(command.help or ""))
        context = click.Context(command, info_name=words[-1])
        usage = " ".join([*words, *command.collect_usage_pieces(context)])
        parts.append(f"```text\n{usage}\n```")
        options = [param for param in command.get_params(context) if isinstance(param, click.Option)]
        rows = [record for one in options if (record := one.get_help_record(context)) is not None]
        if rows:
            parts.append(table(("option", "what"), ((_code(names), text) for names, text in rows)))
    return "\n\n".join(parts) + "\n"


def walk(group: click.Group, words: tuple[str, ...]) -> Iterator[tuple[tuple[str, ...], click.Command]]:
    """Yield each command that does something, with the words that call it."""
    context = click.Context(group, info_name=words[-1])
    for name in group.list_commands(context):
        command = group.get_command(context, name)
        if command is None:
            continue
        if isinstance(command, click.Group):
            yield from walk(command, (*words, name))
        else:
            yield (*words, name), command


def _help(text: str) -> str:
    """Return a help text; what click keeps as it stands is code here."""
    parts = []
    for part in re.split(r"\n\s*\n", text.replace("\f", "")):
        kept = part.strip("\n").startswith("\b")
        body = "\n".join(line.strip() for line in part.replace("\b", "").strip("\n").split("\n"))
        parts.append(f"```text\n{body}\n```" if kept else body.replace("<", "&lt;"))
    return "\n\n".join(parts)


# --- files


def files_page() -> str:
    from robomend.cli.schema import schema_of

    model = schema_of("model")["else"]["properties"]
    agent, robot = schema_of("agent"), schema_of("robot")
    parts = [
        "# Files",
        "The keys of our YAML files, from the schemas that [editors](../editors.md) use (`robomend schema`).",
        "## A model",
        _keys(model),
    ]
    for section in MODEL_SECTIONS:
        parts += [f"### An entry of `{section}`", _keys(model[section]["additionalProperties"]["properties"])]
    parts += ["## An agent's file", _keys(agent["properties"], agent)]
    for section, schema in agent["properties"].items():
        if schema.get("properties"):
            parts += [f"### `{section}`", _keys(schema["properties"], agent)]
    entry = agent["properties"]["processes"]["additionalProperties"]["properties"]
    parts += ["### An entry of `processes`", _keys(entry, agent)]
    for case in agent["$defs"]["action"]["allOf"]:
        kind = case["if"]["properties"]["kind"]["const"]
        parts += [f"### An action of the kind `{kind}`", _keys(case["then"]["properties"], agent)]
    parts += ["## A robot's configuration", _keys(robot["properties"], robot)]
    for name, body in robot["$defs"].items():
        title = f"### {name.removesuffix('Body')}"
        parts += [title, body.get("description", ""), _keys(body["properties"])]
    return "\n\n".join(parts) + "\n"


def _keys(properties: dict[str, Any], whole: dict[str, Any] | None = None) -> str:
    rows = (
        (_code(key), kind_of(schema, whole or {}), _default(schema), schema.get("description", ""))
        for key, schema in properties.items()
    )
    return table(("key", "is", "default", "what"), rows)


def _default(schema: dict[str, Any]) -> str:
    default = schema.get("default")
    if default is None:
        return ""
    return _code(str(default).lower() if isinstance(default, bool) else default)


def kind_of(schema: dict[str, Any], whole: dict[str, Any]) -> str:
    """Return in words what a schema lets through."""
    if "$ref" in schema:
        return str(schema["$ref"]).rpartition("/")[2].removesuffix("Body")
    if "const" in schema:
        return _code(schema["const"])
    if "enum" in schema:
        words = [word for word in schema["enum"] if isinstance(word, str)]
        return "true, false" if True in schema["enum"] else ", ".join(map(_code, words))
    if "anyOf" in schema:
        kinds = (kind_of(one, whole) for one in schema["anyOf"])
        return " or ".join(dict.fromkeys(kind for kind in kinds if kind != "null"))
    types = schema.get("type", "anything")
    names = [types] if isinstance(types, str) else [name for name in types if name != "null"]
    if {"string", "number", "boolean"} <= set(names):
        names = ["text", *(name for name in names if name == "array")]
    said = {"string": "text", "array": "list", "object": "mapping", "integer": "whole number"}
    text = " or ".join(said.get(name, name) for name in names)
    least = schema.get("minimum", schema.get("exclusiveMinimum"))
    most = schema.get("maximum", schema.get("exclusiveMaximum"))
    if least is not None:
        text += f" {'above' if 'exclusiveMinimum' in schema else 'from'} {least:g}"
    if most is not None:
        text += f" {'below' if 'exclusiveMaximum' in schema else 'to'} {most:g}"
    return text


def observers_page() -> str:
    from robomend.cli.schema import schema_of

    parts = [
        "# Kinds of observers",
        "The keys of each kind, from its class; [observers](../observers.md) says what they do.",
    ]
    for case in schema_of("agent")["$defs"]["observer"]["allOf"]:
        parts += [f"## {case['if']['properties']['kind']['const']}", _keys(case["then"]["properties"])]
    return "\n\n".join(parts) + "\n"


def settings_page() -> str:
    from robomend.settings import Settings

    def rows() -> Iterator[Row]:
        for name, field in Settings.model_fields.items():
            default = field.get_default(call_default_factory=True)
            yield _code(name), _code(f"ROBOMEND_{name.upper()}"), _code(default), field.description or ""

    return (
        "# Settings\n\nOf `robomend serve`: a file, a variable, an option; "
        "[settings](../settings.md) says which counts.\n\n"
        + table(("setting", "variable", "default", "what"), rows())
    )


# --- HTTP


def http_page() -> str:
    from robomend.api.app import ROUTERS
    from robomend.security import RULES

    def rows() -> Iterator[Row]:
        for module in ROUTERS:
            for route in module.router.routes:
                for method in sorted(getattr(route, "methods", ())):
                    if not getattr(route, "include_in_schema", False):
                        continue
                    roles = RULES.get((method, route.path))
                    who = "everyone" if roles is None else ", ".join(sorted(role.value for role in roles))
                    says = (route.endpoint.__doc__ or "").strip().split("\n\n")[0]
                    yield method, _code(route.path), who, says

    return (
        "# HTTP routes\n\n"
        "From the code of the routes; the service shows them with bodies and answers at `/docs`. "
        "[HTTP](../http.md) says how to use them.\n\n" + table(("method", "path", "who may", "what"), rows())
    )


def errors_page() -> str:
    from robomend import errors
    from robomend.api.problems import HTTP_CODES, STATUS

    def rows() -> Iterator[Row]:
        for one in vars(errors).values():
            if isinstance(one, type) and issubclass(one, errors.RobomendError):
                status = next(STATUS[cls] for cls in one.__mro__ if cls in STATUS)
                leaves = 3 if issubclass(one, errors.BackendError) else 2
                says = (one.__doc__ or "").strip().split("\n\n")[0]
                yield _code(one.code), status, leaves, says
        for status, code in HTTP_CODES.items():
            yield _code(code), status, "", HTTPStatus(status).phrase

    return (
        "# Error codes\n\nThe `code` is stable; its status over HTTP, and the exit code of a command.\n\n"
        + table(("code", "status", "exit code", "what"), rows())
    )


def events_page() -> str:
    from robomend_client import events

    said = re.findall(r'= "(\w+)"  # data: (.*)', inspect.getsource(events.Kind))
    return (
        "# Events\n\nThe kinds of `GET /events` and what their `data` holds; "
        "[HTTP](../http.md#waiting-for-news) says how the stream goes.\n\n"
        + table(("kind", "data"), ((_code(kind), data) for kind, data in said))
    )
