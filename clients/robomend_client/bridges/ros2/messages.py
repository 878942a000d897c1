"""Values out of messages of any type.

ROS 2 sends no definitions along, only (from Iron on) their hash. A definition is looked for where the robot
has its packages (AMENT_PREFIX_PATH, and the folders in the agent's file), then among those that rosbags
carries; where the publisher tells a hash, only one that has it will do. rosbags is imported with the first
message that somebody wants to look into.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from robomend_client.agent.ring import TopicDescription
from robomend_client.bridges.fields import UnreadableMessage
from robomend_client.bridges.opened import KnownType, OpenedMessage, undescribed

LONGEST_DEFINITION = 256 * 1024
MOST_TYPES = 512

Definitions = dict[str, Any]
"""Name of a type, std_msgs/msg/String -> constants and fields, as rosbags has them."""


def folders_of(environment: Mapping[str, str], more: Iterable[Path]) -> tuple[Path, ...]:
    """Return where definitions are looked for: each has PACKAGE/msg/NAME.msg."""
    prefixes = filter(None, environment.get("AMENT_PREFIX_PATH", "").split(":"))
    return (*more, *(Path(prefix) / "share" for prefix in prefixes))


class MessageReaders:
    """How the messages of each type are read."""

    def __init__(self, folders: Sequence[Path] = ()) -> None:
        self._folders = tuple(folders)
        self._types: dict[tuple[str, str], KnownType | str] = {}  # or why there is none

    def open(self, kind: str, type_hash: str, data: bytes) -> OpenedMessage:
        """Return the message, to look into.

        Args:
            kind: std_msgs/String.
            type_hash: what the publisher says of its definition; or nothing.

        Raises:
            UnreadableMessage: there is no such definition.
        """
        found = self._known(kind, type_hash)
        if isinstance(found, str):
            raise UnreadableMessage(found)
        return found.open(data)

    def described(self, kind: str, type_hash: str) -> TopicDescription:
        """Return how messages of a type are to be read elsewhere."""
        found = self._known(kind, type_hash)
        if isinstance(found, str):
            return undescribed(kind.replace("/", "/msg/", 1), found, cdr=True)
        return found.described()

    def _known(self, kind: str, type_hash: str) -> KnownType | str:
        found = self._types.get((kind, type_hash))
        if found is None:
            found = self._find(kind, type_hash)
            if len(self._types) < MOST_TYPES:
                self._types[kind, type_hash] = found
        return found

    def _find(self, kind: str, type_hash: str) -> KnownType | str:
        package, _, short = kind.rpartition("/")
        name = f"{package}/msg/{short}"
        why = f"there is no definition of {kind} here: name the folder of its package under `messages:`"
        for definitions in self._sources():
            try:
                store = _store(name, definitions)
            except LookupError:
                continue
            except ValueError as error:
                why = f"the definition of {kind} cannot be read: {error}"[:300]
                continue
            if type_hash and store.hash_rihs01(name) != type_hash:
                why = f"the definition of {kind} here is not its publisher's: the type hashes differ"
                continue
            return KnownType(store, name, kind, cdr=True)
        return why

    def _sources(self) -> Iterator[Callable[[str], Any]]:
        """Return what gives the definition of a name, the likeliest first."""
        from rosbags.typesys import Stores, get_typestore

        known = [store for store in reversed(Stores) if store.name.startswith("ROS2_")]
        latest = get_typestore(known[0])
        yield lambda name: self._from_folders(name) or latest.fielddefs[name]
        for store in known:
            yield get_typestore(store).fielddefs.__getitem__

    def _from_folders(self, name: str) -> Any:
        from rosbags.typesys import get_types_from_msg

        for folder in self._folders:
            file = folder / f"{name}.msg"
            if file.is_file() and file.stat().st_size <= LONGEST_DEFINITION:
                try:
                    return get_types_from_msg(file.read_text(errors="replace"), name)[name]
                except Exception as error:  # rosbags raises what the text makes it
                    raise ValueError(f"{file}: {error}") from error
        return None


def _store(name: str, definitions: Callable[[str], Any]) -> Any:
    """Return a store with a type and all that it is made of.

    Raises:
        LookupError, ValueError: there is no definition, or it is none.
    """
    from rosbags.typesys import Stores, get_typestore

    found: Definitions = {}
    missing = [name]
    while missing:
        wanted = missing.pop()
        if wanted in found:
            continue
        if len(found) >= MOST_TYPES:
            raise ValueError(f"it is made of more than {MOST_TYPES} types")
        found[wanted] = definitions(wanted)
        missing += (part for _, node in found[wanted][1] if (part := _named(node)))
    store = get_typestore(Stores.EMPTY)
    store.register(found)
    return store


def _named(node: Any) -> str | None:
    """Return the type that a field is of, if it is another message's."""
    kind, inside = node
    if kind == 1:  # a base type
        return None
    return str(inside) if kind == 2 else _named(inside[0])
