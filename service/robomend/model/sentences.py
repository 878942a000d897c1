"""The sentence language of user rules and observations: text to formulas.

    sentence   :=  implies ( `<->` implies )*                    binds weakest
    implies    :=  or [ `->` implies ]
    or         :=  and ( `or` and )*
    and        :=  unary ( `and` unary )*
    unary      :=  `not` unary  |  quantified  |  `(` sentence `)`  |  `true`  |  `false`  |  atom
    quantified :=  ( `forall` | `exists` ) binding ( `,` binding )* [ `where` guard ] `:` sentence
    binding    :=  NAME ( `,` NAME )* `in` SORT
    guard      :=  [ `not` ] RELATION ( names ) ( `and` … )*
    atom       :=  NAME [ `(` NAME ( `,` NAME )* `)` ]

A quantifier reaches as far to the right as it can. A name holds letters, digits and `_ . / -`, or is anything
in double quotes (`\\"` and `\\\\` inside them); a leading `/` is dropped. `not` is also written `~`, `!` or
`¬`; `and` is `&`, `∧`; `or` is `|`, `∨`; the arrows `→`, `↔`; the quantifiers `∀`, `∃`. `ok(current(arm))` is
`ok(current,arm)`. A bound name hides a name of the model; in quotes it is always the name.

The relations of a guard are those that the model fixes (`drives(node, device)`, `publishes(node, topic)`, …,
see Vocabulary.relations), and `same(a, b)`.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping
from typing import NamedTuple

from robomend.errors import ObservationError
from robomend.model.formulas import (
    And,
    Formula,
    Iff,
    Implies,
    Leaf,
    Not,
    Or,
    Quantified,
    Truth,
    Variable,
)
from robomend_client.literals import Atom, Literal
from robomend_client.near import did_you_mean

MAX_LENGTH = 10_000
"""Characters of one sentence."""

MAX_DEPTH = 60
"""Parentheses, negations, arrows and quantifiers inside one another."""

TOKEN = re.compile(
    r"""\s*(?:
        (?P<name>(?:[\w./]|-(?!>))+)
      | (?P<quoted>"(?:[^"\\]|\\.)*")
      | (?P<symbol><->|->|[(),:~!¬&∧|∨→↔∀∃])
    )""",
    re.VERBOSE | re.DOTALL,
)
BLANK = re.compile(r"\s*\Z")
ESCAPE = re.compile(r"\\(.)", re.DOTALL)
WORDS = {
    "not": "not", "~": "not", "!": "not", "¬": "not",
    "and": "and", "&": "and", "∧": "and",
    "or": "or", "|": "or", "∨": "or",
    "->": "->", "→": "->", "<->": "<->", "↔": "<->",
    "forall": "forall", "∀": "forall", "exists": "exists", "∃": "exists",
    "true": "true", "false": "false", "(": "(", ")": ")", ",": ",", ":": ":",
}  # fmt: skip
SAME = "same"


class Token(NamedTuple):
    kind: str  # "name", "quoted", a word of the language, or "end"
    text: str
    position: int


MEANT = {
    "==>": "->",
    "=>": "->",
    "⇒": "->",
    "<=>": "<->",
    "⇔": "<->",
    "&&": "and",
    "||": "or",
}
"""Signs of other languages, the longer before those that they begin with, and the words for them here."""


def tokens(sentence: str) -> list[Token]:
    """Return the tokens of a sentence, ended by one of kind "end".

    Raises:
        ObservationError: it is too long, or a character belongs to no token.
    """
    if len(sentence) > MAX_LENGTH:
        raise ObservationError(
            f"the sentence has {len(sentence)} characters; at most {MAX_LENGTH} are read", sentence[:80]
        )
    found: list[Token] = []
    at = 0
    while not BLANK.match(sentence, at):
        while sentence[at].isspace():
            at += 1
        meant = next((one for one in MEANT if sentence.startswith(one, at)), None)
        if meant is not None:
            raise ObservationError(f"{meant!r} is not known: write {MEANT[meant]!r}", sentence, at)
        match = TOKEN.match(sentence, at)
        if match is None:
            if sentence[at] == '"':
                raise ObservationError("the quoted name is not closed", sentence, at)
            raise ObservationError(
                f"unexpected character {sentence[at]!r}; put names with such characters in double quotes",
                sentence,
                at,
            )
        group = match.lastgroup or ""
        text = match[group]
        position = match.start(group)
        if group == "quoted":
            found.append(Token("quoted", ESCAPE.sub(r"\1", text[1:-1]), position))
        else:
            found.append(Token(WORDS.get(text, "name"), text, position))
        at = match.end()
    found.append(Token("end", "", len(sentence)))
    return found


def plain(name: str) -> str:
    """Return the name without the leading `/` that ROS writes."""
    return name.lstrip("/") or name


def parse(
    sentence: str, sorts: Mapping[str, Collection[str]] = {}, relations: Collection[str] = ()
) -> Formula:
    """Return the formula that a sentence says; atoms are as written, not yet checked against a model.

    Args:
        sorts: what quantifiers may range over, and `relations` what their guards may speak of.

    Raises:
        ObservationError: with the sentence and the 0-based position.
    """
    return _Parser(sentence, sorts, relations).whole()


class _Parser:
    """Recursive descent; each method returns the formula that starts at the current token."""

    def __init__(
        self, sentence: str, sorts: Mapping[str, Collection[str]], relations: Collection[str]
    ) -> None:
        self.sentence = sentence
        self.sorts = sorts
        self.relations = relations
        self.tokens = tokens(sentence)
        self.next = 0
        self.depth = 0
        self.bound: list[str] = []

    def whole(self) -> Formula:
        if self.tokens[0].kind == "end":
            raise ObservationError("the sentence is empty", self.sentence)
        formula = self.sentence_()
        if self.peek != "end":
            raise self.unexpected("`and`, `or`, `->`, `<->` or the end")
        return formula

    @property
    def peek(self) -> str:
        return self.tokens[self.next].kind

    def take(self, kind: str | None = None) -> Token:
        token = self.tokens[self.next]
        if kind is not None and token.kind != kind:
            raise self.unexpected(f"`{kind}`")
        self.next += 1
        return token

    def accept(self, kind: str) -> bool:
        if self.peek == kind:
            self.next += 1
            return True
        return False

    def unexpected(self, expected: str) -> ObservationError:
        token = self.tokens[self.next]
        got = "the sentence ends" if token.kind == "end" else f"`{token.text}`"
        return ObservationError(f"expected {expected}, but here {got}", self.sentence, token.position)

    def deeper(self) -> None:
        self.depth += 1
        if self.depth > MAX_DEPTH:
            raise ObservationError(
                f"nested deeper than {MAX_DEPTH}", self.sentence, self.tokens[self.next].position
            )

    def sentence_(self) -> Formula:
        depth = self.depth
        formula = self.implies()
        while self.accept("<->"):
            self.deeper()
            formula = Iff(formula, self.implies())
        self.depth = depth
        return formula

    def implies(self) -> Formula:
        left = self.or_()
        if not self.accept("->"):
            return left
        self.deeper()
        right = self.implies()
        self.depth -= 1
        return Implies(left, right)

    def or_(self) -> Formula:
        parts = [self.and_()]
        while self.accept("or"):
            parts.append(self.and_())
        return parts[0] if len(parts) == 1 else Or(tuple(parts))

    def and_(self) -> Formula:
        parts = [self.unary()]
        while self.accept("and"):
            parts.append(self.unary())
        return parts[0] if len(parts) == 1 else And(tuple(parts))

    def unary(self) -> Formula:
        kind = self.peek
        if kind in ("name", "quoted"):
            return self.atom()
        if kind in ("true", "false"):
            return Truth(self.take().kind == "true")
        self.deeper()
        if kind == "not":
            self.take()
            formula: Formula = Not(self.unary())
        elif kind == "(":
            self.take()
            formula = self.sentence_()
            self.take(")")
        elif kind in ("forall", "exists"):
            formula = self.quantified(self.take().kind == "forall")
        else:
            raise self.unexpected("a literal, `not`, `(`, `forall` or `exists`")
        self.depth -= 1
        return formula

    def atom(self) -> Leaf:
        token = self.take()
        predicate = plain(token.text) if token.kind == "name" else token.text
        args = self.names() if self.peek == "(" else ()
        return Leaf(Literal(Atom(predicate, args)), token.position)

    def names(self) -> tuple[str, ...]:
        """Return the names between parentheses; `f(a)` among them counts as the two names `f,a`."""
        self.take("(")
        found: list[str] = []
        while True:
            token = self.take()
            if token.kind == "quoted":
                found.append(plain(token.text))
            elif token.kind == "name":
                found.append(Variable(token.text) if token.text in self.bound else plain(token.text))
                if self.peek == "(":
                    self.deeper()
                    found.extend(self.names())
                    self.depth -= 1
            else:
                self.next -= 1
                word = "; a word of the language needs double quotes" if token.text.isalpha() else ""
                raise self.unexpected(f"a name{word}")
            if self.accept(")"):
                return tuple(found)
            if not self.accept(","):
                raise self.unexpected("`,` or `)`")

    def quantified(self, universal: bool) -> Formula:
        before = len(self.bound)
        bindings: list[tuple[Variable, str]] = []
        while True:
            bindings.extend(self.binding())
            if not self.accept(","):
                break
        for _ in bindings:
            self.deeper()
        guard: list[Literal] = []
        if self.peek == "name" and self.tokens[self.next].text == "where":
            self.take()
            guard.append(self.related())
            while self.accept("and"):
                guard.append(self.related())
        self.take(":")
        body = self.sentence_()
        del self.bound[before:]
        self.depth -= len(bindings)
        for index in reversed(range(len(bindings))):
            variable, sort = bindings[index]
            last = index == len(bindings) - 1
            body = Quantified(universal, variable, sort, tuple(guard) if last else (), body)
        return body

    def binding(self) -> list[tuple[Variable, str]]:
        variables: list[Variable] = []
        while True:
            token = self.take("name")
            if token.text in self.bound:
                raise ObservationError(f"`{token.text}` is bound already", self.sentence, token.position)
            variables.append(Variable(token.text))
            self.bound.append(token.text)
            if not self.accept(","):
                break
        if self.peek != "name" or self.tokens[self.next].text != "in":
            raise self.unexpected("`in` and a sort")
        self.take()
        sort = self.take("name")
        if sort.text not in self.sorts:
            raise ObservationError(_unknown("sort", sort.text, self.sorts), self.sentence, sort.position)
        return [(variable, sort.text) for variable in variables]

    def related(self) -> Literal:
        positive = not self.accept("not")
        token = self.take("name")
        if token.text != SAME and token.text not in self.relations:
            message = _unknown("relation", token.text, (*self.relations, SAME))
            raise ObservationError(message, self.sentence, token.position)
        args = self.names()
        if len(args) != 2:
            raise ObservationError(f"`{token.text}` relates two names", self.sentence, token.position)
        return Literal(Atom(token.text, args), positive)


def _unknown(what: str, name: str, known: Collection[str]) -> str:
    listed = f"; there are {', '.join(sorted(known)) or 'none'}"
    return f"no {what} is named `{name}`{did_you_mean(name, known, '`{}`'.format) or listed}"
