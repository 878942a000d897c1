"""`robomend schema`: what editors need to check and complete our YAML files while they are written."""

from __future__ import annotations

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
        from robomend_client.yaml_schema import DRAFT

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


def schema_text(file: str) -> str:
    """Return the schema of one of FILES as a file has it."""
    import json

    return json.dumps(schema_of(file), indent=1, ensure_ascii=False) + "\n"


def schema_name(file: str) -> str:
    """Return where the schema of one of FILES lies, seen from a file beside FOLDER."""
    return f"{FOLDER}/{file}.schema.json"


def schema_line(file: str) -> str:
    """Return the comment by which an editor finds the schema."""
    return f"# yaml-language-server: $schema={schema_name(file)}\n"
