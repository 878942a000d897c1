"""A robot's configuration as a file: YAML or JSON, with the fields of PUT /robots/{robot}."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

from robomend.errors import InputError
from robomend_client.yaml_tree import Mapping, Scalar, Tree, YamlError, read_tree

LARGEST = 4 << 20

MODEL_KEYS = frozenset({"robomend", "hardware", "nodes", "topics", "rules"})
"""Of component models; a robot's configuration has none of them."""

_INTEGER = re.compile(r"[-+]?[0-9]+\Z")
_NUMBER = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?\Z")
_BOOLEAN = {"true": True, "True": True, "TRUE": True, "false": False, "False": False, "FALSE": False}


def read_robot(path: Path) -> dict[str, Any]:
    """Return the configuration that a file holds; what its fields may be, the service says.

    Scalars mean what they do in YAML 1.2: `on` is a word, and 22:00 is not a number of base 60.

    Raises:
        InputError: no such file, no YAML, or no mapping.
    """
    try:
        if path.stat().st_size > LARGEST:
            raise InputError(f"{path}: larger than {LARGEST >> 20} MiB: no robot's configuration")
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise InputError(f"{path} is not UTF-8 text") from error
    return read_robot_text(text, str(path))


def read_robot_text(text: str, file: str) -> dict[str, Any]:
    """Return the configuration that a text holds; `file` is for complaints.

    Raises:
        InputError: no YAML, or no mapping.
    """
    try:
        tree = read_tree(text)
    except YamlError as error:
        raise InputError(f"{file}:{error.line or 1}: {error}") from error
    if not isinstance(tree, Mapping):
        raise InputError(f"{file}:{tree.line}: a robot's configuration is a mapping, as `model: tedusar`")
    if "model" not in tree.items and (of_model := MODEL_KEYS & tree.items.keys()):
        raise InputError(
            f"{file}:{tree.line}: this is a model (it has {', '.join(sorted(of_model))}), and a robot's "
            f"configuration is wanted: write a file with `model: NAME`, and add `--model {file}`"
        )
    return {name: plain(value) for name, value in tree.items.items()}


def place_in(path: Path, place: str) -> str:
    """Return where a field of a robot's file is, as `robot.yaml:3`; `board.port` is a field of a field.

    The line is that of the innermost part that the file has.
    """
    tree = read_tree(path.read_text(encoding="utf-8"))
    line = tree.line
    for name in place.split("."):
        if isinstance(tree, Mapping) and name in tree.items:
            line, tree = tree.lines[name], tree.items[name]
        elif not isinstance(tree, Mapping | Scalar) and name.isdigit() and int(name) < len(tree.items):
            tree = tree.items[int(name)]
            line = tree.line
        else:
            break
    return f"{path}:{line}"


def plain(tree: Tree) -> Any:
    """Return a tree as JSON has it, by the rules of YAML 1.2."""
    if isinstance(tree, Mapping):
        return {name: plain(value) for name, value in tree.items.items()}
    if not isinstance(tree, Scalar):
        return [plain(one) for one in tree.items]
    if tree.empty:
        return None
    if not tree.plain:
        return tree.text
    if tree.text in _BOOLEAN:
        return _BOOLEAN[tree.text]
    if _INTEGER.match(tree.text):
        return int(tree.text)
    return float(tree.text) if _NUMBER.match(tree.text) else tree.text


def robot_text(config: dict[str, Any]) -> str:
    """Return a configuration as YAML that `read_robot` reads back as it was."""
    return "".join(f"{name}: {json.dumps(value, ensure_ascii=False)}\n" for name, value in config.items())
