"""`robomend schema`: what editors need to check and complete our YAML files while they are written."""

from __future__ import annotations

from functools import cache
from typing import Any

import click

FILES = ("model", "agent", "robot", "observers")
FOLDER = "schemas"
"""Beside a file, in which its first line looks for its schema."""


@click.command("schema")
@click.argument("file", metavar="|".join(FILES), type=click.Choice(FILES))
def command(file: str) -> None:
    """Write the JSON Schema of a model, an agent's file, a robot's configuration or a file of observers.

    It is made from the code that reads these files, with the kinds of observers and actions installed here.
    An editor with the YAML language server takes it from the first line of a file:

    \b
    robomend schema model > schemas/model.schema.json
    # yaml-language-server: $schema=schemas/model.schema.json
    """
    click.echo(schema_text(file), nl=False)


def schema_of(file: str) -> dict[str, Any]:
    """Return the schema of one of FILES."""
    if file == "model":
        from robomend.model.json_schema import model_schema

        return model_schema()
    if file == "robot":
        from robomend.api.schemas.robots import RobotBody
        from robomend_client.yaml_reader import DRAFT

        return {
            "$schema": DRAFT,
            **RobotBody.model_json_schema(),
            "title": "robomend: a robot's configuration",
        }
    if file == "agent":
        from robomend_client.agent.schema import agent_schema

        return agent_schema()
    from robomend_client.observers.schema import observers_file_schema

    return observers_file_schema()


@cache
def schema_text(file: str) -> str:
    """Return the schema of one of FILES as a file has it, its descriptions as an editor shows them."""
    import json

    return json.dumps(shown(schema_of(file)), indent=1, ensure_ascii=False) + "\n"


def shown(schema: dict[str, Any]) -> dict[str, Any]:
    """Return a schema whose descriptions say the defaults, too: of a key, editors show nothing else.

    Titles made of the names of keys and classes, which they would show as well, are left out.
    """
    found: dict[str, Any] = {}
    for keyword, value in schema.items():
        if keyword == "properties":
            found[keyword] = {name: _shown_key(shown(key)) for name, key in value.items()}
        elif keyword == "$defs":
            found[keyword] = {name: _untitled(shown(one)) for name, one in value.items()}
        elif isinstance(value, list):
            found[keyword] = [shown(one) if isinstance(one, dict) else one for one in value]
        else:
            found[keyword] = shown(value) if isinstance(value, dict) else value
    return found


def _shown_key(key: dict[str, Any]) -> dict[str, Any]:
    default = key.get("default")
    told = [] if default in (None, [], {}) else [f"default: {_written(default)}"]
    if told or "description" in key:
        said = [key["description"]] if "description" in key else []
        key = {**key, "description": "; ".join([*said, *told])}
    return _untitled(key)


def _untitled(schema: dict[str, Any]) -> dict[str, Any]:
    return {keyword: value for keyword, value in schema.items() if keyword != "title"}


def _written(default: object) -> str:
    """Return a default as it is written in YAML."""
    import json

    if isinstance(default, float):
        return f"{default:g}"
    return default if isinstance(default, str) else json.dumps(default)


def schema_name(file: str) -> str:
    """Return where the schema of one of FILES lies, seen from a file beside FOLDER."""
    return f"{FOLDER}/{file}.schema.json"


def schema_line(file: str) -> str:
    """Return the comment by which an editor finds the schema."""
    return f"# yaml-language-server: $schema={schema_name(file)}\n"
