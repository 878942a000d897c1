"""From a file or text to a System, whatever its format: component model, five-key model or circuit."""

from __future__ import annotations

import re
from pathlib import Path

from robomend.errors import ModelError
from robomend.model.bench import circuit
from robomend.model.budget import MODEL_STEPS
from robomend.model.compiling import compile_robot
from robomend.model.component_yaml import read_model
from robomend.model.components import KINDS
from robomend.model.five_key import KEYS, read_five_key, system_of
from robomend.model.other_formats import named, named_bytes
from robomend.model.system import System
from robomend_client.yaml_tree import Mapping, YamlError, read_tree

FORMATS = ("component", "five-key", "bench")
OF_AGENTS = {"observers", "agent", "service", "processes", "ros1", "ros2"}
"""Keys of an agent's file."""

MAX_BYTES = 256 * 1024 * 1024
CIRCUIT = re.compile(
    r"^\s*P?(?:INPUT|OUTPUT)\s*\(|^\s*[^\s#:=]+\s*=\s*\w+\s*\(", re.MULTILINE | re.IGNORECASE
)


def load_model(path: str | Path) -> System:
    """Return the system description in a file.

    Raises:
        ModelError: the file cannot be read, or is no model; with file, line and what is allowed.
    """
    path = Path(path)
    try:
        if path.stat().st_size > MAX_BYTES:
            raise ModelError(f"larger than {MAX_BYTES // 2**20} MiB", str(path))
        data = path.read_bytes()
        text = data.decode("utf-8-sig")
    except OSError as error:
        raise ModelError(f"cannot be read: {error.strerror or error}", str(path)) from error
    except UnicodeDecodeError as error:
        if other := named_bytes(data):
            raise ModelError(other, str(path)) from error
        line = data.count(b"\n", 0, error.start) + 1
        raise ModelError("not UTF-8 text; save the file as UTF-8", str(path), line) from error
    return load_text(text, name=path.stem, file=str(path))


def load_text(
    text: str,
    *,
    name: str | None = None,
    file: str | None = None,
    format: str | None = None,
    most: int = MODEL_STEPS,
) -> System:
    """Return the system description in a text.

    Args:
        name: of the model, where the text gives none.
        file: for the places in errors.
        format: one of FORMATS; without it the text decides.
        most: steps that it may take (robomend.model.budget); five-key models and circuits take as many as
            they have characters, at most.

    Raises:
        ModelError: with file, line and what is allowed.
    """
    if format is not None and format not in FORMATS:
        raise ModelError(f"no model format is named `{format}`; there are {', '.join(FORMATS)}", file)
    if format == "bench" or (format is None and CIRCUIT.search(text[:100_000])):
        try:
            return circuit(text, name=name, file=file)
        except ModelError as error:
            if format is None and (other := named(text)):
                raise ModelError(other, file) from error
            raise
    try:
        tree = read_tree(text)
    except YamlError as error:
        if other := named(text):
            raise ModelError(other, file) from error
        raise ModelError(error.message, file, error.line) from error
    keys = tree.items.keys() if format is None and isinstance(tree, Mapping) else ()
    if format == "component" or "robomend" in keys:
        return compile_robot(read_model(tree, name, file), source=text, file=file, most=most)
    found = {key for key in KEYS if key in keys}
    if found == {"rules"} and any(kind.section in keys for kind in KINDS):
        found.clear()  # a component model has rules, too
    if format == "five-key" or found:
        return system_of(read_five_key(tree, file), name=name or "model", source=text, file=file)
    if other := named(text):
        raise ModelError(other, file)
    if isinstance(tree, Mapping) and not OF_AGENTS.isdisjoint(tree.items):
        raise ModelError("this is an agent's file, or its observers; the model is a file beside it", file)
    if not found and {"model", "policy"} & set(keys):
        raise ModelError(
            "this is a robot's configuration, not a model: hand in the file of the model that it names",
            file,
            tree.line,
        )
    raise ModelError(
        "no model: a component model begins with `robomend: 1`, a five-key model has the keys "
        f"{', '.join(KEYS)}, a circuit has lines like INPUT(1)",
        file,
        tree.line,
    )
