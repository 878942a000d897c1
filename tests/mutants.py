"""The mutants of a text: the code with one small change.

A comparison or a sign is turned, a condition negated, a number one higher, a call left out. What a text says
and not does is left alone: annotations, docstrings, messages of errors.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

OPPOSITE: dict[type[ast.AST], Any] = {
    one: other
    for pair in (
        (ast.Eq, ast.NotEq), (ast.Is, ast.IsNot), (ast.In, ast.NotIn), (ast.And, ast.Or), (ast.Add, ast.Sub),
        (ast.Mult, ast.Div), (ast.BitAnd, ast.BitOr), (ast.Lt, ast.LtE), (ast.Gt, ast.GtE),
    )
    for one, other in (pair, pair[::-1])
}  # fmt: skip
CALLS = {"min": "max", "max": "min", "any": "all", "all": "any"}


@dataclass(frozen=True)
class Mutant:
    """One change of one file; `start` and `end` are offsets in its bytes."""

    file: str
    line: int
    start: int
    end: int
    was: str
    becomes: str
    line_text: str  # the line where it begins, as the code has it

    @property
    def key(self) -> tuple[str, str, str, str]:
        """What is the same when lines move: the file, the line's text, what was, what it becomes."""
        return self.file, self.line_text, self.was, self.becomes

    def __str__(self) -> str:
        return f"{self.file}:{self.line}: {self.was}  ->  {self.becomes}"


def changes(node: ast.AST) -> Iterator[ast.AST]:
    """Yield what a node may become."""
    match node:
        case ast.Compare(left=left, ops=[op], comparators=[right]) if type(op) in OPPOSITE:
            yield ast.Compare(left, [OPPOSITE[type(op)]()], [right])
        case ast.BinOp(left=left, op=op, right=right) if type(op) in OPPOSITE:
            yield ast.BinOp(left, OPPOSITE[type(op)](), right)
        case ast.BoolOp(op=op, values=values):
            yield ast.BoolOp(OPPOSITE[type(op)](), values)
        case ast.UnaryOp(op=ast.Not() | ast.USub() | ast.Invert(), operand=operand):
            yield operand
        case ast.Constant(value=bool(value)):
            yield ast.Constant(not value)
        case ast.Constant(value=int(value) | float(value)):
            yield ast.Constant(value + 1)
        case ast.Call(func=ast.Name(id=name)) if name in CALLS:
            yield ast.Call(ast.Name(CALLS[name]), node.args, node.keywords)
        case ast.IfExp(test=test, body=body, orelse=orelse):
            yield ast.IfExp(test=test, body=orelse, orelse=body)
        case ast.If(test=test) | ast.While(test=test) | ast.comprehension(ifs=[test]):
            if not isinstance(test, ast.Compare | ast.UnaryOp):  # those are turned themselves
                yield ast.copy_location(ast.UnaryOp(ast.Not(), test), test)
        case ast.Expr(value=ast.Call() | ast.Await() as value) | ast.AugAssign(value=value):
            yield ast.copy_location(ast.Pass(), node)
        case ast.Break():
            yield ast.Continue()
        case ast.Continue():
            yield ast.Break()


def within(node: ast.AST) -> Iterator[ast.AST]:
    """Yield the nodes that say what the code does: no annotations, no texts, no messages of errors."""
    yield node
    if isinstance(node, ast.JoinedStr | ast.Raise | ast.Import | ast.ImportFrom | ast.pattern):
        return
    if isinstance(node, ast.keyword) and node.arg == "strict":  # of zip: for us, not for the tests
        return
    for name, value in ast.iter_fields(node):
        if name in {"annotation", "returns", "decorator_list", "bases"}:
            continue
        for child in value if isinstance(value, list) else [value]:
            if isinstance(child, ast.AST):
                yield from within(child)


def mutants(source: str, file: str) -> Iterator[Mutant]:
    """Yield every mutant of a text, in its order."""
    text = source.encode()
    starts = [0]
    for line in text.splitlines(keepends=True):
        starts.append(starts[-1] + len(line))
    for node in within(ast.parse(source)):
        for new in changes(node):
            place = new if isinstance(node, ast.If | ast.While | ast.comprehension) else node
            assert isinstance(place, ast.expr | ast.stmt)
            start = starts[place.lineno - 1] + place.col_offset
            end = starts[(place.end_lineno or 0) - 1] + (place.end_col_offset or 0)
            becomes = ast.unparse(new)
            written = becomes if isinstance(new, ast.stmt) else f"({becomes})"
            was = " ".join(text[start:end].decode().split())
            line_text = text[starts[place.lineno - 1] : starts[place.lineno]].decode().strip()
            yield Mutant(file, place.lineno, start, end, was, written, line_text)
