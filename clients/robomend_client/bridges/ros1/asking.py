"""The kinds `ros1_service` and `ros1_parameter`: what nodes of ROS 1 are asked for, over TCPROS.

    reset: {kind: ros1_service, services: {arm: /arm/reset}, type: std_srvs/Trigger}
    set_fps: {kind: ros1_parameter, nodes: {camera: /camera}, parameter: fps, values: {low: 5, high: 30}}

    connect ──► its header: type, md5sum ── as configured? ── no ──► it is not asked
                                              └ yes ──► request ──► ok byte, answer or its own words

A parameter is set by dynamic_reconfigure where the node has that, else on the parameter server.

Source: wiki.ros.org/ROS/TCPROS (service), genmsg for md5 sums, dynamic_reconfigure's messages.
"""

from __future__ import annotations

import asyncio
import hashlib
import json
import os
import re
from abc import abstractmethod
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from robomend_client.actions import (
    FAILED,
    OK,
    REFUSED,
    TIMED_OUT,
    UNREACHABLE,
    Action,
    ActionResult,
    Feedback,
)
from robomend_client.agent.executors.program import TAKES_S
from robomend_client.agent.executors.ros2_asking import Ended, understood, wanted
from robomend_client.agent.executors.ros_programs import (
    SHARE,
    Before,
    NodeAsking,
    ParameterChange,
    ServiceRequest,
    would,
)
from robomend_client.bridges.ros1.messages import full_name
from robomend_client.bridges.ros1.node import RosNode
from robomend_client.bridges.ros1.services import read_header
from robomend_client.bridges.ros1.tcpros import LENGTH, ProtocolError, encode_header, frame
from robomend_client.bridges.ros1.xmlrpc import PeerError, address_of, connect
from robomend_client.python310 import timeout

CONNECT_S = 5.0
LONGEST_ANSWER = 16 * 1024 * 1024
LONGEST_DEFINITION = 64 * 1024

SUCCESS = "bool success\nstring message\n"
DEFINITIONS = {
    "std_srvs/Empty": "---\n",
    "std_srvs/Trigger": f"---\n{SUCCESS}",
    "std_srvs/SetBool": f"bool data\n---\n{SUCCESS}",
    "dynamic_reconfigure/Reconfigure": "Config config\n---\nConfig config\n",
}
MESSAGES = {
    "dynamic_reconfigure/BoolParameter": "string name\nbool value\n",
    "dynamic_reconfigure/IntParameter": "string name\nint32 value\n",
    "dynamic_reconfigure/StrParameter": "string name\nstring value\n",
    "dynamic_reconfigure/DoubleParameter": "string name\nfloat64 value\n",
    "dynamic_reconfigure/GroupState": "string name\nbool state\nint32 id\nint32 parent\n",
    "dynamic_reconfigure/Config": (
        "BoolParameter[] bools\nIntParameter[] ints\nStrParameter[] strs\nDoubleParameter[] doubles\n"
        "GroupState[] groups\n"
    ),
}
LISTS = {bool: "bools", int: "ints", str: "strs", float: "doubles"}

LINE = re.compile(r"(?P<type>[A-Za-z][\w/]*)(?P<array>\[\d*\])?\s+(?P<rest>\S.*)\Z")
NUMBERS = ("int8", "uint8", "int16", "uint16", "int32", "uint32", "int64", "uint64", "float32", "float64")
BASE = frozenset(("bool", "string", "time", "duration", "char", "byte", *NUMBERS))


class ServiceType:
    """A type of services: how requests are written, answers read, and its md5 sum."""

    def __init__(self, name: str, definition: str) -> None:
        """
        Raises:
            ValueError: the definition cannot be read.
        """
        from rosbags.typesys import Stores, get_types_from_msg, get_typestore

        self.name = name
        self._store = get_typestore(Stores.ROS1_NOETIC)
        for kind, text in MESSAGES.items():
            self._store.register(get_types_from_msg(text, full_name(kind)))
        package = name.partition("/")[0]
        parts = re.split(r"^---\s*$", definition, maxsplit=1, flags=re.MULTILINE)
        if len(parts) != 2:
            raise ValueError("a service's definition has a line `---` between request and answer")
        self._kinds: list[str | None] = []
        for text, end in zip(parts, ("Request", "Response"), strict=True):
            if not _lines(text):
                self._kinds.append(None)
                continue
            kind = f"{name}{end}"
            try:
                self._store.register(get_types_from_msg(text, full_name(kind)))
            except Exception as error:  # rosbags raises what the text makes it
                raise ValueError(f"its definition cannot be read: {error}"[:300]) from error
            self._kinds.append(full_name(kind))
        texts = (self._md5_text(text, package) for text in parts)
        self.md5 = hashlib.md5("".join(texts).encode(), usedforsecurity=False).hexdigest()

    def request(self, given: Mapping[str, Any]) -> bytes:
        """Return the bytes of a request; what is not given is empty or 0.

        Raises:
            ValueError: it has no such field, or of another type.
        """
        kind = self._kinds[0]
        if kind is None:
            if given:
                raise ValueError(f"{self.name} has no field {next(iter(given))}")
            return b""
        tree: dict[str, Any] = {}
        for path, value in given.items():
            *way, name = path.split(".")
            at = tree
            for step in way:
                at = at.setdefault(step, {})
            at[name] = value
        try:
            return bytes(self._store.serialize_ros1(self._made(kind, tree), kind))
        except (TypeError, KeyError, AttributeError, OverflowError) as error:
            raise ValueError(str(error)) from error

    def answer(self, body: bytes) -> Any:
        """Return an answer, as an object with its fields; None where it has none.

        Raises:
            Exception: the bytes are none; rosbags raises what it likes.
        """
        kind = self._kinds[1]
        return None if kind is None else self._store.deserialize_ros1(body, kind)

    def _made(self, kind: str, given: Mapping[str, Any]) -> Any:
        fields = dict(self._store.fielddefs[kind][1])
        for name in given:
            if name not in fields:
                raise ValueError(f"{self.name} has no field {name}; there are {', '.join(fields)}")
        return self._store.types[kind](
            **{name: self._part(node, given.get(name)) for name, node in fields.items()}
        )

    def _part(self, node: Any, value: Any) -> Any:
        number, inside = node
        if number == 2:
            return self._made(inside, value or {})
        if number != 1:
            if isinstance(value, str):
                value = json.loads(value) if value.strip().startswith("[") else value.split(",")
            return [self._part(inside[0], one) for one in value or ()]
        base = inside[0]
        if base == "string":
            return "" if value is None else str(value)
        if base == "bool":
            if value in (None, False, "false", "False", "no", "off"):
                return False
            if value in (True, "true", "True", "yes", "on"):
                return True
            raise ValueError(f"{value!r} is neither true nor false")
        if base.startswith("float"):
            return float(value or 0)
        return int(value or 0)

    def _md5_text(self, text: str, package: str) -> str:
        """Return what a part of the definition adds to the md5 sum: constants first."""
        constants, fields = [], []
        for line in _lines(text):
            found = LINE.match(line)
            if found is None:
                continue
            kind, rest = found["type"], found["rest"]
            if "=" in rest:
                name, _, value = rest.partition("=")
                constants.append(f"{kind} {name.strip()}={value.strip()}")
            elif kind in BASE:
                fields.append(f"{kind}{found['array'] or ''} {rest}")
            else:
                header = "std_msgs/Header" if kind == "Header" else f"{package}/{kind}"
                whole = full_name(kind if "/" in kind else header)
                fields.append(f"{self._store.generate_msgdef(whole, ros_version=1)[1]} {rest}")
        return "\n".join((*constants, *fields))


def _lines(text: str) -> list[str]:
    """Return the lines of a definition that say something."""
    found = []
    for line in text.splitlines():
        bare = line.strip() if re.match(r"\s*string\s+\w+\s*=", line) else line.partition("#")[0].strip()
        if bare:
            found.append(bare)
    return found


def definition_of(kind: str) -> str:
    """Return the definition of a type, its own or that of the distribution's packages.

    Raises:
        ValueError: there is none here.
    """
    if kind in DEFINITIONS:
        return DEFINITIONS[kind]
    package, _, name = kind.partition("/")
    folders = [Path(one) for one in os.environ.get("ROS_PACKAGE_PATH", "").split(":") if one]
    for folder in (*folders, Path("/opt/ros/noetic/share"), Path("/usr/share")):
        file = folder / package / "srv" / f"{name}.srv"
        if file.is_file() and file.stat().st_size <= LONGEST_DEFINITION:
            return file.read_text(errors="replace")
    raise ValueError(f"there is no definition of {kind} here: write it under `definition`")


async def ask(node: RosNode, service: str, kind: ServiceType, request: bytes, within_s: float) -> Any:
    """Call a service; return its answer.

    Raises:
        Ended: it was not asked, or has failed, in its own words.
    """
    try:
        uri = await node.master.lookup_service(service)
        if uri is None:
            raise Ended(UNREACHABLE, f"nobody offers the service {service}")
        reader, writer = await connect(*address_of(uri), min(CONNECT_S, within_s))
    except PeerError as error:
        raise Ended(UNREACHABLE, f"{service} cannot be asked: {error}") from error
    try:
        return await _asked(node, service, kind, request, within_s, (reader, writer))
    finally:
        writer.close()


async def _asked(
    node: RosNode,
    service: str,
    kind: ServiceType,
    request: bytes,
    within_s: float,
    connection: tuple[asyncio.StreamReader, asyncio.StreamWriter],
) -> Any:
    reader, writer = connection
    hello = {"callerid": node.name, "service": service, "md5sum": "*", "type": kind.name}
    try:
        async with timeout(min(CONNECT_S, within_s)):
            writer.write(encode_header(hello))
            header = await read_header(reader)
    except (TimeoutError, OSError, EOFError, ProtocolError) as error:
        why = str(error) or "it says nothing"
        raise Ended(UNREACHABLE, f"{service} does not say who it is: {why}; it was not asked") from error
    if "error" in header:
        raise Ended(REFUSED, f"{service} refuses: {header['error'][:300]}")
    found = header.get("type", kind.name)
    if found != kind.name or header.get("md5sum", kind.md5) != kind.md5:
        of = f"of type {found}, not {kind.name}" if found != kind.name else f"another version of {kind.name}"
        raise Ended(REFUSED, f"{service} is {of}; it was not asked")
    try:
        async with timeout(within_s):
            writer.write(frame(request))
            ok = await reader.readexactly(1)
            (length,) = LENGTH.unpack(await reader.readexactly(LENGTH.size))
            if length > LONGEST_ANSWER:
                raise Ended(FAILED, f"{service} answered with {length} bytes")
            body = await reader.readexactly(length)
    except TimeoutError as error:
        said = f"{service} does not answer within {within_s:g} s; whether it acted is unknown"
        raise Ended(TIMED_OUT, said) from error
    except (OSError, EOFError) as error:
        raise Ended(TIMED_OUT, f"{service} went away; whether it acted is unknown") from error
    if ok != b"\1":
        raise Ended(FAILED, f"{service} failed: {body.decode('utf-8', 'replace')[:400]}")
    try:
        return kind.answer(body)
    except Exception as error:
        raise Ended(FAILED, f"the answer of {service} cannot be read: {error}"[:400]) from error


class Ros1Asking(NodeAsking):
    """Asks a node of ROS 1, as our own node."""

    _node: RosNode | None = None

    def attach(self, node: RosNode) -> None:
        """Ask as this node."""
        self._node = node

    @abstractmethod
    async def ask(
        self, node: RosNode, parameters: Sequence[str], said: Mapping[str, Any], within_s: float
    ) -> str:
        """Ask for it; return what came of it.

        Raises:
            Ended: it did not do it.
        """

    async def execute(self, action: Action, feedback: Feedback) -> ActionResult:
        if self._node is None:
            return ActionResult(UNREACHABLE, f"{action}: the agent's file has no section ros1")
        said = self.said(action.parameters)
        if isinstance(said, ActionResult):
            return said
        feedback(1, f"{action}: {would(said)}")
        try:
            within_s = action.timeout_s * SHARE
            return ActionResult(OK, await self.ask(self._node, action.parameters, said, within_s))
        except Ended as ended:
            return ActionResult(ended.code, str(ended))
        except PeerError as error:
            return ActionResult(UNREACHABLE, f"{action}: {error}")


class CallRos1Service(Ros1Asking):
    """Calls a service of ROS 1."""

    def __init__(
        self,
        name: str,
        services: Mapping[str, str],
        type: str,
        request: Mapping[str, str] | None = None,
        parameters: Mapping[str, Sequence[str]] | None = None,
        definition: str | None = None,
        timeout_s: float = TAKES_S,
    ) -> None:
        """
        Args:
            services: the action's first parameter → the service's full name.
            type: the service's type, such as std_srvs/Trigger; of another it is not asked.
            request: field → value, dotted for messages in it; `{NAME}` stands for a parameter.
            parameters: name → what it may be, of further parameters, in the action's order.
            definition: the text of the type's .srv, where no package here has it.
        """
        self._request = ServiceRequest(type, "std_srvs/Trigger", request, parameters)
        super().__init__(name, services, "services", self._request.lists, timeout_s)
        self._type, self._definition = type, definition
        self._kind: ServiceType | None = None

    def said(self, parameters: Sequence[str]) -> dict[str, Any]:
        return self._request.said(self._asked[parameters[0]], parameters[1:])

    async def ask(
        self, node: RosNode, parameters: Sequence[str], said: Mapping[str, Any], within_s: float
    ) -> str:
        service = said["name"]
        try:
            if self._kind is None:
                text = self._definition or definition_of(self._type)
                self._kind = await asyncio.to_thread(ServiceType, self._type, text)
            request = self._kind.request(said["request"])
        except ValueError as error:
            raise Ended(REFUSED, f"the request of {service} cannot be made: {error}") from error
        return understood(service, await ask(node, service, self._kind, request, within_s))


class SetRos1Parameter(Ros1Asking):
    """Sets a parameter of a node of ROS 1, and sets it back."""

    def __init__(
        self, name: str, nodes: Mapping[str, str], change: ParameterChange, timeout_s: float = TAKES_S
    ) -> None:
        """
        Args:
            nodes: the action's first parameter → the node's full name.
        """
        super().__init__(name, nodes, "nodes", (change.words,), timeout_s)
        self.before = Before(change)

    def said(self, parameters: Sequence[str]) -> dict[str, Any] | ActionResult:
        return self.before.said(self._asked[parameters[0]], parameters[1])

    async def ask(
        self, node: RosNode, parameters: Sequence[str], said: Mapping[str, Any], within_s: float
    ) -> str:
        name, parameter = said["name"], said["parameter"]
        what = f"{parameter} of {name}"
        now = await node.master.parameter(f"{name}/{parameter}")
        if now is None:
            raise Ended(REFUSED, f"{what} cannot be set: the parameter server has none of this name")
        try:
            to = wanted(said, now)
        except (TypeError, ValueError) as error:
            raise Ended(REFUSED, f"{what} cannot be set: {error}") from error
        if to == now:
            return f"{what} is {json.dumps(now)} already"
        service = f"{name}/set_parameters"
        if await node.master.lookup_service(service) is not None and type(to) in LISTS:
            reconfigure = "dynamic_reconfigure/Reconfigure"
            kind = await asyncio.to_thread(ServiceType, reconfigure, DEFINITIONS[reconfigure])
            given = {"config": {LISTS[type(to)]: [{"name": parameter, "value": to}]}}
            answer = await ask(node, service, kind, kind.request(given), within_s)
            is_now = {one.name: one.value for one in getattr(answer.config, LISTS[type(to)])}
            if is_now.get(parameter, to) != to:
                given_to = json.dumps(is_now[parameter])
                raise Ended(FAILED, f"{what}, asked to be {json.dumps(to)}, was set to {given_to}")
            how = ""
        else:
            await node.master.set_parameter(f"{name}/{parameter}", to)
            how = " on the parameter server; a node that reads it only at its start does not see it"
        self.before.note(name, parameters[1], now)
        return f"{what} is {json.dumps(to)} now{how}; it was {json.dumps(now)}"
