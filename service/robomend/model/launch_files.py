"""What launch files say of a robot: which nodes it has, under which names, with which remaps. Text in, values
out; nothing is looked up.

    <launch>, ROS 1 and ROS 2     ──┐
    launch: in YAML, ROS 2        ──┼──► Launched: nodes, and what cannot be told
    LaunchDescription in Python   ──┘

A launch file in Python is never run: its syntax tree is read as far as it is made of constants, arguments
with defaults and calls of launch_ros. What hangs on anything else (conditions, loops, other files, the
environment) is a question.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from xml.etree import ElementTree

import yaml

from robomend.errors import InputError

MOST_BYTES = 4 << 20
MOST_NODES = 2000
MOST_DEPTH = 60
MOST_FILES = 200

READ = Callable[[str], str | None]
"""From the name of an included file, as it is written, to its text; None: it is not there."""


@dataclass(frozen=True, slots=True)
class LaunchedNode:
    """A node that a launch file starts."""

    name: str  # with its namespace and slash
    package: str
    executable: str  # or the plugin of a component
    remaps: tuple[tuple[str, str], ...] = ()  # from, to
    container: str = ""  # the node in whose process it is
    sure: bool = True  # whether it is started in any case

    @property
    def said(self) -> str:
        """What is said of it, in a line."""
        parts = [f"{self.package}/{self.executable}".strip("/")]
        parts += [f"in {self.container.removeprefix('/')}"] if self.container else []
        namespace = self.name.rpartition("/")[0]  # /tf to tf, as people write it, changes nothing there
        parts += [f"{old} is {new}" for old, new in self.remaps if _joined(namespace, old) != new]
        return ", ".join(part for part in parts if part)


@dataclass(frozen=True, slots=True)
class Launched:
    """What a launch file starts."""

    nodes: tuple[LaunchedNode, ...]
    questions: tuple[str, ...] = ()


def read_launch(text: str, file: str, read: READ = lambda name: None) -> Launched:
    """Return what a launch file starts.

    Args:
        text: XML, YAML or Python.
        file: its name, for errors and questions.
        read: gives the text of an included file.

    Raises:
        InputError: it is no launch file.
    """
    if len(text) > MOST_BYTES:
        raise InputError(f"{file}: larger than {MOST_BYTES >> 20} MB")
    found = _Found(read)
    _read(text, file, _Scope(), found)
    return Launched(tuple(found.nodes.values()), tuple(dict.fromkeys(found.questions)))


@dataclass
class _Found:
    read: READ
    nodes: dict[str, LaunchedNode] = field(default_factory=dict)
    questions: list[str] = field(default_factory=list)
    files: int = 0

    def add(self, node: LaunchedNode) -> None:
        if len(self.nodes) < MOST_NODES:
            known = self.nodes.get(node.name)
            self.nodes[node.name] = node if known is None else replace(node, sure=node.sure and known.sure)

    def ask(self, question: str) -> None:
        if len(self.questions) < MOST_NODES:
            self.questions.append(question)


@dataclass
class _Scope:
    """What holds at a place of a launch file."""

    namespace: str = "/"
    arguments: dict[str, str | None] = field(default_factory=dict)  # None: nobody knows
    remaps: tuple[tuple[str, str], ...] = ()
    sure: bool = True
    depth: int = 0

    def inner(self, namespace: str = "", sure: bool = True) -> _Scope:
        return _Scope(
            _joined(self.namespace, namespace),
            dict(self.arguments),
            self.remaps,
            self.sure and sure,
            self.depth + 1,
        )


def _joined(namespace: str, name: str) -> str:
    """Return a name in a namespace, with its slash."""
    whole = name if name.startswith("/") else f"{namespace}/{name}"
    return "/" + "/".join(part for part in whole.split("/") if part)


def _read(text: str, file: str, scope: _Scope, found: _Found) -> None:
    found.files += 1
    if scope.depth > MOST_DEPTH or found.files > MOST_FILES:
        found.ask(f"{file}: files include each other too often")
    elif re.match(r"\ufeff?\s*<", text):
        _Tree(file, found).run(_of_xml(text, file), scope)
    elif re.search(r"^launch:\s*(?:#.*)?$", text, re.MULTILINE):
        _Tree(file, found).run(_of_yaml(text, file), scope)
    elif "LaunchDescription" in text or "launch_ros" in text:
        _Python(text, file, found).run(scope)
    else:
        raise InputError(
            f"{file}: no launch file: neither <launch>, `launch:` nor a LaunchDescription is in it"
        )


# --- XML and YAML are one tree ----------------------------------------------------------------------------


@dataclass
class _Element:
    tag: str
    attributes: dict[str, str]
    children: list[_Element] = field(default_factory=list)


def _of_xml(text: str, file: str) -> _Element:
    if re.search(r"<!(?:DOCTYPE|ENTITY)", text):  # nothing of ROS has them, and they can grow without bound
        raise InputError(f"{file}: XML with a DOCTYPE is not read")
    try:
        root = ElementTree.fromstring(text.removeprefix("\ufeff"))
    except ElementTree.ParseError as error:
        raise InputError(f"{file}: {error}") from error
    if root.tag != "launch":
        raise InputError(f"{file}: no launch file: it is <{root.tag}>, not <launch>")

    def element(one: ElementTree.Element, depth: int = 0) -> _Element:
        inner = [] if depth > MOST_DEPTH else [element(child, depth + 1) for child in one]
        return _Element(one.tag.replace("-", "_"), dict(one.attrib), inner)

    return element(root)


def _of_yaml(text: str, file: str) -> _Element:
    try:
        tree = yaml.safe_load(text)
    except (yaml.YAMLError, RecursionError) as error:
        raise InputError(f"{file}: {error}") from error
    budget = [MOST_NODES * 20]  # aliases may name one thing again and again

    def element(tag: str, value: object, depth: int = 0) -> _Element:
        budget[0] -= 1
        if budget[0] < 0 or depth > MOST_DEPTH:
            raise InputError(f"{file}: too large")
        one = _Element(tag.replace("-", "_"), {})
        for key, inner in value.items() if isinstance(value, dict) else [("children", value)]:
            if isinstance(inner, list):
                for item in inner:
                    if key == "children" and isinstance(item, dict):
                        one.children += [element(str(name), what, depth + 1) for name, what in item.items()]
                    else:
                        one.children.append(element(str(key), item, depth + 1))
            elif isinstance(inner, dict):
                one.children.append(element(str(key), inner, depth + 1))
            elif inner is not None:
                one.attributes[str(key)] = str(inner).lower() if isinstance(inner, bool) else str(inner)
        return one

    return element("launch", tree.get("launch") if isinstance(tree, dict) else tree)


SUBSTITUTION = re.compile(r"\$\(([\w-]+)\s*((?:[^()]|\$\([^()]*\))*)\)")
TRUE, FALSE = ("true", "1", "yes", "on"), ("false", "0", "no", "off")


class _Tree:
    """Walks an XML or YAML launch file."""

    def __init__(self, file: str, found: _Found) -> None:
        self._file = file
        self._found = found

    def run(self, root: _Element, scope: _Scope) -> None:
        self._all(root.children, scope)

    def _all(self, elements: Sequence[_Element], scope: _Scope) -> None:
        for one in elements:
            sure = self._condition(one, scope)
            if sure is None or (sure and scope.depth <= MOST_DEPTH):
                visit = getattr(self, f"_visit_{one.tag}", None)
                if visit is not None:
                    visit(one, scope if sure else scope.inner(sure=False))

    def _condition(self, one: _Element, scope: _Scope) -> bool | None:
        """Return whether an element counts; None: that cannot be told."""
        for name, wanted in (("if", True), ("unless", False)):
            if name in one.attributes:
                text = self._text(one.attributes[name], scope)
                low = None if text is None else text.strip().lower()
                if low in TRUE or low in FALSE:
                    if (low in TRUE) != wanted:
                        return False
                else:
                    return None
        return True

    def _text(self, text: str | None, scope: _Scope) -> str | None:
        """Return a text with its substitutions; None if one of them is not known."""
        if text is None:
            return None
        for _ in range(10):
            match = SUBSTITUTION.search(text)
            if match is None:
                return text
            value = self._substituted(match[1], match[2].strip(), scope)
            if value is None:
                return None
            text = text[: match.start()] + value + text[match.end() :]
            if len(text) > 4096:
                return None
        return None

    @staticmethod
    def _substituted(kind: str, what: str, scope: _Scope) -> str | None:
        if kind in ("arg", "var"):
            return scope.arguments.get(what.strip("'\""))
        if kind in ("env", "optenv") and " " in what:
            return what.split(None, 1)[1].strip("'\"")
        if kind == "anon":
            return what
        if kind in ("find", "find-pkg-share"):
            return f"[{what}]"
        return "." if kind == "dirname" else None

    def _visit_arg(self, one: _Element, scope: _Scope) -> None:
        name = one.attributes.get("name", "")
        given = one.attributes.get("value", one.attributes.get("default"))
        if "value" in one.attributes or name not in scope.arguments:
            scope.arguments[name] = self._text(given, scope)

    def _visit_let(self, one: _Element, scope: _Scope) -> None:
        scope.arguments[one.attributes.get("name", one.attributes.get("var", ""))] = self._text(
            one.attributes.get("value"), scope
        )

    def _visit_remap(self, one: _Element, scope: _Scope) -> None:
        scope.remaps += self._remaps([one], scope)

    _visit_set_remap = _visit_remap

    def _visit_push_ros_namespace(self, one: _Element, scope: _Scope) -> None:
        text = self._text(one.attributes.get("namespace", one.attributes.get("ns")), scope)
        if text is None:
            self._ask(f"in which namespace, `{one.attributes.get('namespace')}`, are its nodes?")
        else:
            scope.namespace = _joined(scope.namespace, text)

    def _visit_group(self, one: _Element, scope: _Scope) -> None:
        scoped = one.attributes.get("scoped", "true").lower() not in FALSE
        self._all(one.children, self._in(one, scope) if scoped else scope)

    def _in(self, one: _Element, scope: _Scope) -> _Scope:
        given = one.attributes.get("ns", one.attributes.get("namespace", ""))
        text = self._text(given, scope)
        if text is None:
            self._ask(f"in which namespace is what has `{given}`?")
        return scope.inner(text or "")

    def _visit_include(self, one: _Element, scope: _Scope) -> None:
        written = one.attributes.get("file", "")
        name = self._text(written, scope)
        text = None if name is None else self._found.read(name)
        if text is None or name is None:
            self._ask(f"what does `{written}` start, which it includes?")
            return
        inner = self._in(one, scope)
        inner.arguments = (
            {} if one.attributes.get("pass_all_args", "false").lower() not in TRUE else inner.arguments
        )
        for child in one.children:
            if child.tag in ("arg", "let"):
                given = child.attributes.get("value", child.attributes.get("default"))
                inner.arguments[child.attributes.get("name", "")] = self._text(given, scope)
        _read(text, name, inner, self._found)

    def _visit_node(self, one: _Element, scope: _Scope, container: str = "") -> None:
        there = self._in(one, scope)
        executable = one.attributes.get("type", one.attributes.get("exec", one.attributes.get("plugin", "")))
        executable = self._text(executable, scope) or executable
        given = one.attributes.get("name", one.attributes.get("node_name", executable.rpartition("::")[2]))
        name = self._text(given, scope)
        if name is not None and not {"name", "node_name"} & one.attributes.keys():
            self._ask(f"is {one.attributes.get('pkg', '?')}/{executable} called {name}? It is not said")
        if name is None:
            self._ask(f"what is the node `{given}` of {one.attributes.get('pkg', '?')} called?")
            return
        if one.attributes.get("pkg") == "nodelet":
            words = (self._text(one.attributes.get("args"), scope) or "").split()
            if len(words) > 2 and words[0] == "load":
                executable, container = words[1], _joined(scope.namespace, words[2])
        self._found.add(
            LaunchedNode(
                _joined(there.namespace, name),
                self._text(one.attributes.get("pkg", ""), scope) or "",
                executable,
                scope.remaps + self._remaps(one.children, there),
                container,
                scope.sure,
            )
        )
        for child in one.children:
            if child.tag == "composable_node":
                self._all_in(child, scope, _joined(there.namespace, name))

    _visit_lifecycle_node = _visit_node

    def _visit_node_container(self, one: _Element, scope: _Scope) -> None:
        self._visit_node(one, scope)

    def _visit_load_composable_node(self, one: _Element, scope: _Scope) -> None:
        target = self._text(one.attributes.get("target"), scope) or "a container"
        for child in one.children:
            if child.tag == "composable_node":
                self._all_in(child, scope, _joined(scope.namespace, target))

    def _all_in(self, one: _Element, scope: _Scope, container: str) -> None:
        sure = self._condition(one, scope)
        if sure is not False:
            self._visit_node(one, scope if sure else scope.inner(sure=False), container)

    def _remaps(self, elements: Sequence[_Element], scope: _Scope) -> tuple[tuple[str, str], ...]:
        found = []
        for one in elements:
            if one.tag == "remap":
                old = self._text(one.attributes.get("from"), scope)
                new = self._text(one.attributes.get("to"), scope)
                if old is not None and new is not None:
                    found.append((old, _joined(scope.namespace, new)))
                else:
                    self._ask(f"what is `{one.attributes.get('from')}` remapped to?")
        return tuple(found)

    def _ask(self, question: str) -> None:
        self._found.ask(f"{self._file}: {question}")


# --- Python -----------------------------------------------------------------------------------------------

NODES = ("Node", "LifecycleNode", "ComposableNodeContainer", "ComposableNode")


class _Python:
    """Reads the syntax tree of a launch file."""

    def __init__(self, text: str, file: str, found: _Found) -> None:
        self._file = file
        self._found = found
        try:
            self._tree = ast.parse(text)
        except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
            raise InputError(f"{file}: {error}") from error
        self._values: dict[str, ast.expr | None] = {}  # by variable; None: it has several
        self._parents: dict[int, ast.AST] = {}
        self._done: set[int] = set()
        for node in ast.walk(self._tree):
            for child in ast.iter_child_nodes(node):
                self._parents[id(child)] = node
            if isinstance(node, ast.Assign) and len(node.targets) == 1:
                target = node.targets[0]
                if isinstance(target, ast.Name):
                    self._values[target.id] = None if target.id in self._values else node.value

    def run(self, scope: _Scope) -> None:
        calls = [node for node in ast.walk(self._tree) if isinstance(node, ast.Call)]
        calls.sort(key=lambda call: (call.lineno, call.col_offset))
        for call in calls:
            if _called(call) == "DeclareLaunchArgument":
                name = self._text(_argument(call, "name", 0), scope)
                if name is not None and name not in scope.arguments:
                    scope.arguments[name] = self._text(_argument(call, "default_value", 1), scope)
        for kind in ("LaunchDescription", "GroupAction"):
            for call in calls:
                if _called(call) == kind and id(call) not in self._done:
                    self._group(call, scope)
        for call in calls:
            self._action(call, scope)

    def _group(self, call: ast.Call, scope: _Scope) -> None:
        """Walk what is in a group: a namespace that is pushed holds for what follows."""
        self._done.add(id(call))
        inner = self._conditional(call, scope).inner()
        listed = _argument(call, "actions") or _argument(call, "initial_entities", 0)
        for one in self._items(listed):
            if not isinstance(one, ast.Call):
                continue
            if _called(one) in ("PushRosNamespace", "PushROSNamespace"):
                text = self._text(_argument(one, "namespace", 0), scope)
                if text is None:
                    self._ask(one, "in which namespace are the nodes of this group?")
                inner.namespace = _joined(inner.namespace, text or "")
            elif _called(one) == "SetRemap":
                inner.remaps += self._pair(_argument(one, "src", 0), _argument(one, "dst", 1), one, inner)
            elif _called(one) == "GroupAction":
                self._group(one, inner)
            else:
                for deeper in ast.walk(one):
                    if isinstance(deeper, ast.Call):
                        self._action(deeper, inner)

    def _items(self, value: ast.expr | None) -> Iterator[ast.expr]:
        """Yield the items of a list, with what its variables stand for."""
        value = self._followed(value)
        if isinstance(value, ast.BinOp) and isinstance(value.op, ast.Add):
            yield from self._items(value.left)
            yield from self._items(value.right)
        for one in value.elts if isinstance(value, ast.List | ast.Tuple) else ():
            item = self._followed(one)
            if item is not None:
                yield item

    def _followed(self, value: ast.expr | None) -> ast.expr | None:
        for _ in range(10):
            if not isinstance(value, ast.Name):
                break
            value = self._values.get(value.id)
        return value

    def _action(self, call: ast.Call, scope: _Scope, container: str = "") -> None:
        if id(call) in self._done:
            return
        if _called(call) == "IncludeLaunchDescription":
            self._done.add(id(call))
            self._include(call, scope)
        if _called(call) == "LoadComposableNodes":
            self._done.add(id(call))
            target = self._text(_argument(call, "target_container", 0), scope) or "a container"
            for one in self._items(_argument(call, "composable_node_descriptions", 1)):
                if isinstance(one, ast.Call):
                    self._action(one, self._conditional(call, scope), _joined(scope.namespace, target))
        if _called(call) not in NODES:
            return
        self._done.add(id(call))
        scope = self._conditional(call, scope)
        package = self._text(_argument(call, "package"), scope) or ""
        written = (
            _argument(call, "executable") or _argument(call, "node_executable") or _argument(call, "plugin")
        )
        executable = self._text(written, scope) or ""
        named = _argument(call, "name") or _argument(call, "node_name")
        name = self._text(named, scope) if named is not None else executable.rpartition("::")[2]
        spaced = _argument(call, "namespace") or _argument(call, "node_namespace")
        namespace = self._text(spaced, scope) if spaced is not None else ""
        looped = self._inside(call, (ast.For, ast.While, ast.ListComp, ast.GeneratorExp, ast.SetComp))
        if not name or (looped and not isinstance(named, ast.Constant)):
            more = ", in a loop" if looped else ""
            self._ask(call, f"what is the node of {package or '?'}/{executable or '?'} called{more}?")
            return
        if named is None:
            self._ask(call, f"is {package}/{executable} called {name}? It is not said")
        if namespace is None:
            self._ask(call, f"in which namespace is {name}?")
        remaps: tuple[tuple[str, str], ...] = scope.remaps
        there = scope.inner(namespace or "", sure=not self._inside(call, (ast.If, ast.IfExp)))
        for one in self._items(_argument(call, "remappings")):
            both = [*self._items(one)]
            if len(both) == 2:
                remaps += self._pair(both[0], both[1], call, there)
        whole = _joined(there.namespace, name)
        self._found.add(LaunchedNode(whole, package, executable, remaps, container, there.sure))
        for one in self._items(_argument(call, "composable_node_descriptions")):
            if isinstance(one, ast.Call):
                self._action(one, scope, whole)

    def _pair(
        self, old: ast.expr | None, new: ast.expr | None, at: ast.Call, scope: _Scope
    ) -> tuple[tuple[str, str], ...]:
        texts = self._text(old, scope), self._text(new, scope)
        if texts[0] is None or texts[1] is None:
            self._ask(at, f"what is {texts[0] or 'a topic'} remapped to?")
            return ()
        return ((texts[0], _joined(scope.namespace, texts[1])),)

    def _conditional(self, call: ast.Call, scope: _Scope) -> _Scope:
        """Return the scope of what has a condition."""
        condition = self._followed(_argument(call, "condition"))
        return scope if condition is None else replace(scope, sure=False)

    def _include(self, call: ast.Call, scope: _Scope) -> None:
        source = self._followed(_argument(call, "launch_description_source", 0))
        inner = source.args[0] if isinstance(source, ast.Call) and source.args else source
        name = self._text(inner, scope)
        text = None if name is None else self._found.read(name)
        if name is None or text is None:
            files = [
                one.value
                for one in ast.walk(self._followed(inner) or call)
                if isinstance(one, ast.Constant) and isinstance(one.value, str) and "launch" in one.value
            ]
            self._ask(
                call, f"what does {files[-1] if files else 'the launch file'} start, which it includes?"
            )
            return
        there = self._conditional(call, scope).inner()
        given = self._followed(_argument(call, "launch_arguments", 1))
        if isinstance(given, ast.Call) and isinstance(given.func, ast.Attribute):  # a dictionary's items()
            given = self._followed(given.func.value)
        pairs: list[tuple[ast.expr | None, ast.expr]] = []
        if isinstance(given, ast.Dict):
            pairs = list(zip(given.keys, given.values, strict=True))
        for one in self._items(given):
            both = [*self._items(one)]
            pairs += [(both[0], both[1])] if len(both) == 2 else []
        for key, value in pairs:
            argument = self._text(key, scope)
            if argument is not None:
                there.arguments[argument] = self._text(value, scope)
        _read(text, name, there, self._found)

    def _text(self, value: ast.expr | None, scope: _Scope, depth: int = 0) -> str | None:
        """Return a text that is made of constants and arguments; None if it is not."""
        value = self._followed(value)
        if value is None or depth > 20:
            return None
        if isinstance(value, ast.Constant):
            return str(value.value) if isinstance(value.value, str | int | float) else None
        parts: list[ast.expr] | None = None
        between = ""
        if isinstance(value, ast.List | ast.Tuple):
            parts = value.elts
        elif isinstance(value, ast.JoinedStr):
            parts = [one.value if isinstance(one, ast.FormattedValue) else one for one in value.values]
        elif isinstance(value, ast.BinOp) and isinstance(value.op, ast.Add):
            parts = [value.left, value.right]
        elif isinstance(value, ast.Call):
            called = _called(value)
            if called == "LaunchConfiguration":
                name = self._text(_argument(value, "variable_name", 0), scope, depth + 1)
                if name is not None and name not in scope.arguments and depth < 10:
                    return self._text(_argument(value, "default", 1), scope, depth + 10)
                return None if name is None else scope.arguments.get(name)
            if called == "ThisLaunchFileDir" or (called == "dirname" and "__file__" in ast.dump(value)):
                return "."
            if called == "TextSubstitution":
                return self._text(_argument(value, "text", 0), scope, depth + 1)
            if called in ("EnvironmentVariable", "get") and len(value.args) + len(value.keywords) > 1:
                return self._text(_argument(value, "default_value", 1), scope, depth + 1)
            if called in ("get_package_share_directory", "FindPackageShare", "FindPackage"):
                name = self._text(_argument(value, "package", 0), scope, depth + 1)
                return None if name is None else f"[{name}]"
            if called in ("join", "PathJoinSubstitution"):
                first = self._followed(value.args[0]) if value.args else None
                is_list = isinstance(first, ast.List | ast.Tuple)
                parts = first.elts if is_list else value.args  # type: ignore[union-attr]  # it is one of them
                between = "/"
        if parts is None:
            return None
        texts = [self._text(part, scope, depth + 1) for part in parts]
        known = [text for text in texts if text is not None]
        return between.join(known) if len(known) == len(texts) else None

    def _inside(self, node: ast.AST, kinds: tuple[type[ast.AST], ...]) -> bool:
        at: ast.AST | None = node
        while at is not None:
            at = self._parents.get(id(at))
            if isinstance(at, kinds):
                return True
        return False

    def _ask(self, at: ast.expr, question: str) -> None:
        self._found.ask(f"{self._file}, line {at.lineno}: {question}")


def _called(call: ast.Call) -> str:
    """Return the last name of what is called."""
    function = call.func
    if isinstance(function, ast.Attribute):
        return function.attr
    return function.id if isinstance(function, ast.Name) else ""


def _argument(call: ast.Call, name: str, place: int | None = None) -> ast.expr | None:
    found: Mapping[str | None, ast.expr] = {one.arg: one.value for one in call.keywords}
    if name in found:
        return found[name]
    return call.args[place] if place is not None and place < len(call.args) else None
