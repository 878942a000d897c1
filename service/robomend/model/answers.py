"""What a first model asks, and what people answered: both are lines of the model itself.

    camera:    # … of which device?           camera:
      # drives: []                              drives: [left_camera]     and under `hardware:` the device
    #   scan was silent …: by design?         #   scan was silent …: by design? yes
      plan: [scan, image]                       plan: [scan]
                                            #   does plan rest on image? no

What repairs and drills contradict (`Arrow`) is asked as well: then the answer brings its question along.
`from_graph` writes the questions. The page shows them, and puts each answer where its question was; what is
made anew of the same robot takes the answers over. Whoever edits the text by hand answers as well.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

from robomend.errors import InputError
from robomend.model.component_yaml import MAX_NAME
from robomend.model.from_graph import (
    DRIVES,
    LISTENED,
    QUESTIONS,
    TIGHTER,
    arrow_question,
    comment,
    device_question,
    sign_of,
    word,
)

NODE = re.compile(r'  (?P<name>"(?:[^"\\]|\\.)+"|[^\s"#:][^\s:]*):')
ANSWER = re.compile(r"#   (?P<asked>.+\?)(?: (?P<answer>\S.*))?\Z")
SECONDS = re.compile(LISTENED.replace("{}", r"(\d+)"))
OPEN = DRIVES.strip()
WORDS = ("yes", "no")
ARROW = re.compile(r"does (?P<topic>.+) rest on (?P<input>.+)\?")
OUTPUT = re.compile(r'      (?P<name>"(?:[^"\\]|\\.)+"|[^\s"#:][^\s:]*): \[(?P<inputs>[^\]]*)\]')
RAISED = f"{QUESTIONS}repairs and drills raised:"
AGAIN = "no: listen again when it is mended (robomend attach --update)"


@dataclass(frozen=True)
class Questions:
    """What a model asks now."""

    seconds: int  # that somebody listened
    drivers: Mapping[str, str]  # nodes that may drive a device, each with a name for it
    others: tuple[str, ...]  # to be answered by yes or no

    def __bool__(self) -> bool:
        return bool(self.drivers or self.others)


@dataclass(frozen=True)
class GivenAnswers:
    """What people said."""

    drives: Mapping[str, tuple[str, ...]] = field(default_factory=dict)  # node -> its devices, maybe none
    devices: Mapping[str, str] = field(default_factory=dict)  # -> the line that says what it is
    others: Mapping[str, str] = field(default_factory=dict)  # question -> answer


def questions_of(text: str) -> Questions:
    """Return what a model that was made by listening asks; of another one, nothing."""
    found = SECONDS.search(text)
    if found is None:
        return Questions(0, {}, ())
    lines = text.split("\n")
    drivers = {name: _device(name) for name, _, said in _nodes(lines) if said is None}
    named = {comment(device_question(name)) for name, _, _ in _nodes(lines)}
    others = tuple(asked for asked, answer in _asked(lines) if not answer and asked not in named)
    return Questions(int(found[1]), drivers, others)


def asks_of_arrow(text: str, topic: str, given: str) -> bool:
    """Return whether an answer would be a line of this text: it has the arrow, and nobody has answered."""
    lines = text.split("\n")
    question = comment(arrow_question(topic, given))
    return question not in dict(_asked(lines)) and _arrow(lines, topic, given) is not None


def answers_of(text: str) -> GivenAnswers:
    """Return what a text says of the questions that a first model asks."""
    lines = text.split("\n")
    drives = {name: _names(said) for name, _, said in _nodes(lines) if said is not None}
    devices = dict(_entries(lines, "hardware"))
    return GivenAnswers(drives, devices, {asked: answer for asked, answer in _asked(lines) if answer})


def asking(text: str, question: str) -> str:
    """Return a text that asks this as well: by yes or no."""
    lines = text.rstrip("\n").split("\n")
    if not any(line.startswith(QUESTIONS) for line in lines):
        lines += ["", f"{QUESTIONS}the agent raised:"]
    return "\n".join([*lines, f"#   {comment(question)}", ""])


def with_answers(text: str, answers: GivenAnswers) -> str:
    """Return a text with answers, where it has their questions; the rest of the answers is left out."""
    lines = text.split("\n")
    devices: list[str] = []
    for name, number, said in list(_nodes(lines)):
        if said is None and name in answers.drives:
            lines[number] = f"    drives: [{', '.join(map(word, answers.drives[name]))}]"
            devices += answers.drives[name]
    there = dict(_entries(lines, "hardware"))
    ordered = [one for one in answers.devices if one in devices]
    ordered += [one for one in devices if one not in answers.devices]
    new = [one for one in dict.fromkeys(ordered) if one not in there]
    _add_devices(lines, [answers.devices.get(one, f"  {word(one)}: {{blame_hardware: true}}") for one in new])
    named = {comment(device_question(name)) for name in answers.drives}
    for number, line in enumerate(lines):
        asked = ANSWER.match(line)
        if asked and not asked["answer"] and (asked["asked"] in answers.others or asked["asked"] in named):
            said = answers.others.get(asked["asked"], "answered")
            lines[number] += f" {said}"
            if said == "no" and (arrow := ARROW.fullmatch(asked["asked"])):
                _strike(lines, arrow["topic"], arrow["input"])
    there_now = dict(_asked(lines))
    for question, said in answers.others.items():
        if question not in there_now and (arrow := ARROW.fullmatch(question)):
            _answer_arrow(lines, arrow["topic"], arrow["input"], said)
    return "\n".join(lines)


def answered(text: str, question: str, answer: str) -> str:
    """Return the text with one answer.

    Args:
        question: a node of `drivers`, or one of `others`.
        answer: of a node its devices, by commas, or nothing; else yes or no.

    Raises:
        InputError: the text does not ask that, or not so.
    """
    asked = questions_of(text)
    if question in asked.drivers:
        devices = tuple(name for one in answer.split(",") if (name := one.strip()))
        if not all(one.isprintable() and len(one) <= MAX_NAME for one in devices):
            raise InputError(f"a device's name has at most {MAX_NAME} printable letters")
        return with_answers(text, GivenAnswers(drives={question: devices}))
    if question in asked.others:
        if answer not in WORDS:
            raise InputError("answer by yes or no")
        again = answer == "no" and TIGHTER not in question and not ARROW.fullmatch(question)
        return with_answers(text, GivenAnswers(others={question: AGAIN if again else answer}))
    if (arrow := ARROW.fullmatch(question)) and asks_of_arrow(text, arrow["topic"], arrow["input"]):
        if answer not in WORDS:
            raise InputError("answer by yes or no")
        return with_answers(text, GivenAnswers(others={comment(question): answer}))
    raise InputError(f"the model does not ask that: {question[:100]!r}")


def _device(node: str) -> str:
    """Return a name for what a node drives; no component has it already."""
    last = node.rpartition("/")[2]
    found = re.sub(r"_?(?:driver|node)(?:_node)?\Z|\Adriver_", "", last) or last
    return found if found != node else f"{found}_device"


def _nodes(lines: list[str]) -> Iterator[tuple[str, int, str | None]]:
    """Yield the nodes that say what they drive, or are asked: name, line, what is said."""
    inside, name = False, ""
    for number, line in enumerate(lines):
        if line[:1] not in (" ", "#", ""):
            inside = line.startswith("nodes:")
        elif inside and (found := NODE.match(line)):
            name = _name(found["name"])
        elif inside and name and line.strip() == OPEN:
            yield name, number, None
        elif inside and name and (said := re.match(r"    drives: \[(.*)\]", line)):
            yield name, number, said[1]


def _entries(lines: list[str], section: str) -> Iterator[tuple[str, str]]:
    """Yield the entries of a section that take one line each."""
    inside = False
    for line in lines:
        if line[:1] not in (" ", "#", ""):
            inside = line.startswith(f"{section}:")
        elif inside and (found := NODE.match(line)):
            yield _name(found["name"]), line


def _asked(lines: list[str]) -> Iterator[tuple[str, str]]:
    """Yield the questions at the end of a model, each with its answer."""
    first = next((n for n, line in enumerate(lines) if line.startswith(QUESTIONS)), len(lines))
    for line in lines[first + 1 :]:
        if found := ANSWER.match(line):
            yield found["asked"], found["answer"] or ""


def _arrow(lines: list[str], topic: str, given: str) -> tuple[int, re.Match[str]] | None:
    """Return the line that says that a topic rests on another, among other things."""
    inside = False
    for number, line in enumerate(lines):
        if line[:1] not in (" ", "#", ""):
            inside = line.startswith("nodes:")
        found = OUTPUT.match(line) if inside else None
        if found is None or comment(_name(found["name"])) != topic:
            continue
        if given in map(comment, _names(found["inputs"])):
            return number, found
    return None


def _answer_arrow(lines: list[str], topic: str, given: str, said: str) -> None:
    """Take an arrow out, or leave it in, and write down what was said."""
    if _arrow(lines, topic, given) is None:
        return
    if said == "no":
        _strike(lines, topic, given)
    while lines and not lines[-1]:
        lines.pop()
    if not any(line.startswith(QUESTIONS) for line in lines):
        lines += ["", RAISED]
    lines += [f"#   {arrow_question(topic, given)} {said}", ""]


def _strike(lines: list[str], topic: str, given: str) -> None:
    """Take an arrow out, if it is there."""
    if (place := _arrow(lines, topic, given)) is not None:
        number, found = place
        without = {given, sign_of(given, "qos")}  # that its messages arrive matters to nobody then
        kept = [name for name in _names(found["inputs"]) if comment(name) not in without]
        named = ", ".join(map(word, kept))
        before, after = found.string[: found.start("inputs")], found.string[found.end("inputs") :]
        lines[number] = f"{before}{named}{after}"


def _add_devices(lines: list[str], new: list[str]) -> None:
    """Add lines at the end of the devices."""
    if not new:
        return
    place = next((n for n, line in enumerate(lines) if line.startswith("hardware:")), None)
    if place is None:
        place = next(number for number, line in enumerate(lines) if line.startswith("nodes:"))
        lines[place:place] = ["hardware:", *new, ""]
        return
    while lines[place + 1].startswith(" "):
        place += 1
    lines[place + 1 : place + 1] = new


def _name(text: str) -> str:
    return str(json.loads(text)) if text.startswith('"') else text


def _names(text: str) -> tuple[str, ...]:
    found = re.findall(r'"(?:[^"\\]|\\.)*"|[^\s,]+', text)
    return tuple(map(_name, found))
