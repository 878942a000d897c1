"""A node of ROS 2 over zenoh that does what lines of JSON on its standard input say, as ros2_node.py.

    {"do": "publish", "topic": "/scan", "type": "std_msgs/String", "value": {"data": "x"}, "rate": 10}
    {"do": "subscribe", "topic": "/diagnosis", "type": …}    what comes is printed: {"heard": topic, …}

`stamped`: a header has the robot's time. `raw` instead of `value`: bytes in hexadecimal; `hash`: instead of
the type's own; `attachment`: which of rmw_zenoh's forms. Keys, tokens and attachments are written from
rmw_zenoh's documented format, not with our code: it is the other side.
"""

from __future__ import annotations

import json
import struct
import sys
import threading
import time
from typing import Any

import numpy as np
import xxhash
import zenoh
from rosbags.typesys import Stores, get_typestore
from zenoh.ext import CacheConfig, declare_advanced_publisher

STORE = get_typestore(Stores.ROS2_KILTED)


def say(**value: Any) -> None:
    sys.stdout.write(json.dumps(value) + "\n")
    sys.stdout.flush()


def long_name(name: str) -> str:
    package, _, short = name.partition("/")
    return f"{package}/msg/{short}"


def made(kind: str, value: dict[str, Any]) -> Any:
    """Return a message of the type, with zeros where nothing is given."""
    found = {}
    for name, node in STORE.fielddefs[kind][1]:
        found[name] = part(node, value.get(name))
    return STORE.types[kind](**found)


def part(node: Any, value: Any) -> Any:
    shape, inside = node
    if shape == 1:
        empty = "" if inside[0] == "string" else False if inside[0] == "bool" else 0
        return empty if value is None else value
    if shape == 2:
        return made(inside, value or {})
    items = [part(inside[0], item) for item in (value or [])]
    numbers = inside[0][0] == 1 and inside[0][1][0] != "string"
    return np.array(items, inside[0][1][0]) if numbers else items


def plain(value: Any) -> Any:
    if hasattr(value, "__dataclass_fields__"):
        return {n: plain(getattr(value, n)) for n in value.__dataclass_fields__ if not n.startswith("__")}
    if isinstance(value, (list, tuple)):
        return [plain(item) for item in value]
    return value.tolist() if hasattr(value, "tolist") else value


def attached(form: str, number: int, gid: bytes) -> bytes | None:
    """Return an attachment in one of the forms that releases have."""
    stamps = struct.pack("<qq", number, time.time_ns())
    if form == "bare":
        return stamps + bytes([len(gid)]) + gid
    if form == "no length":
        return stamps + gid
    if form == "named":
        names = [
            bytes([len(name)]) + name.encode()
            for name in ("sequence_number", "source_timestamp", "source_gid")
        ]
        return names[0] + stamps[:8] + names[1] + stamps[8:] + names[2] + bytes([16]) + gid[::-1]
    return None if form == "none" else bytes.fromhex(form)


class Commands:
    def __init__(self, endpoint: str, domain: str, name: str) -> None:
        config = zenoh.Config()
        config.insert_json5("mode", '"peer"')
        config.insert_json5("scouting/multicast/enabled", "false")
        config.insert_json5("connect/endpoints", json.dumps([endpoint]))
        config.insert_json5("listen/endpoints", '["tcp/localhost:0"]')
        config.insert_json5("timestamping/enabled", "true")
        self.session = zenoh.open(config)
        self.domain = domain
        self.name = name
        self.ids = iter(range(1, 10**6))
        self.tokens: dict[str, Any] = {"": self.token(f"NN/%/%/{name}", 0)[0]}
        self.stops: dict[str, threading.Event] = {}
        self.threads: dict[str, threading.Thread] = {}
        self.kept: dict[str, Any] = {}
        self.robots_s = 0  # the robot's time, by /clock

    def token(self, rest: str, number: int) -> tuple[Any, str]:
        key = f"@ros2_lv/{self.domain}/{self.session.info.zid()}/0/{number}/{rest}"
        return self.session.liveliness().declare_token(key), key

    def topic_token(self, kind: str, line: dict[str, Any]) -> str:
        """Declare a publisher or a subscriber; return its key."""
        durability = "1" if line.get("latched") else ""
        what = f"{self.name}/{line['topic'].replace('/', '%')}/{self.wire(line)}/:{durability}:,10:,:,:,,"
        self.tokens[kind + line["topic"]], key = self.token(f"{kind}/%/%/{what}", next(self.ids))
        return key

    def wire(self, line: dict[str, Any]) -> str:
        """Type and hash, as keys have them."""
        package, _, short = line["type"].partition("/")
        type_hash = line.get("hash") or STORE.hash_rihs01(long_name(line["type"]))
        return f"{package}::msg::dds_::{short}_/{type_hash}"

    def nothing(self, line: dict[str, Any]) -> None:
        pass

    def simulated(self, line: dict[str, Any]) -> None:
        """Live by /clock."""
        kind = long_name("rosgraph_msgs/Clock")

        def ticked(sample: Any) -> None:
            told: Any = STORE.deserialize_cdr(sample.payload.to_bytes(), kind)
            self.robots_s = told.clock.sec

        self.kept["clock"] = self.session.declare_subscriber(f"{self.domain}/clock/*/*", ticked)

    def bare_token(self, line: dict[str, Any]) -> None:
        """Declare a token of any text."""
        self.tokens[line["key"]] = self.session.liveliness().declare_token(line["key"])

    def also(self, line: dict[str, Any]) -> None:
        """Be another node, too."""
        namespace = line.get("namespace", "/").replace("/", "%")
        self.tokens[line["name"]] = self.token(f"NN/%/{namespace}/{line['name']}", next(self.ids))[0]

    def no_longer(self, line: dict[str, Any]) -> None:
        self.tokens.pop(line["name"]).undeclare()

    def publish(self, line: dict[str, Any]) -> None:
        topic = line["topic"]
        token = self.topic_token("MP", line)
        gid = xxhash.xxh3_128(token.encode()).intdigest().to_bytes(16, "little")
        kind = long_name(line["type"])

        def data() -> bytes:
            if "raw" in line:
                return bytes.fromhex(line["raw"])
            value = {"stamp": {"sec": self.robots_s}} if line.get("stamped") else line.get("value", {})
            return bytes(STORE.serialize_cdr(made(kind, value), kind))

        key = f"{self.domain}{topic}/{self.wire(line)}"
        publisher: Any
        if line.get("latched"):
            publisher = declare_advanced_publisher(
                self.session, key, cache=CacheConfig(1), publisher_detection=True
            )
        else:
            publisher = self.session.declare_publisher(key)
        self.kept[topic] = publisher
        stop = self.stops[topic] = threading.Event()
        form = line.get("attachment", "bare")

        def once(number: int) -> None:
            publisher.put(data(), attachment=attached(form, number, gid))

        def again() -> None:
            number = 0
            while not stop.wait(1 / line["rate"]):
                number += 1
                once(number)

        if "rate" in line:
            thread = self.threads[topic] = threading.Thread(target=again, daemon=True)
            thread.start()
        else:
            once(1)

    def hush(self, line: dict[str, Any]) -> None:
        self.stops.pop(line["topic"]).set()
        if (thread := self.threads.pop(line["topic"], None)) is not None:
            thread.join()  # a publisher in the middle of a message cannot be undeclared

    def unpublish(self, line: dict[str, Any]) -> None:
        self.hush(line)
        self.kept.pop(line["topic"]).undeclare()
        self.tokens.pop("MP" + line["topic"]).undeclare()

    def subscribe(self, line: dict[str, Any]) -> None:
        topic, kind = line["topic"], long_name(line["type"])
        self.topic_token("MS", line)

        def heard(sample: Any) -> None:
            value = STORE.deserialize_cdr(sample.payload.to_bytes(), kind)
            said = sample.attachment.to_bytes().hex()
            say(heard=topic, value=plain(value), key=str(sample.key_expr), attachment=said)

        self.kept["sub" + topic] = self.session.declare_subscriber(
            f"{self.domain}{topic}/{self.wire(line)}", heard
        )


def main() -> None:
    endpoint, *more, name = sys.argv[1:]
    commands = Commands(endpoint, more[0] if more else "0", name)
    for text in sys.stdin:
        line = json.loads(text)
        try:
            say(answer=getattr(commands, line["do"])(line))
        except Exception as error:  # noqa: BLE001  # told to the test
            say(error=f"{type(error).__name__}: {error}")


if __name__ == "__main__":
    main()
