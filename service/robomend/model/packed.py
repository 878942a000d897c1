"""What is large travels packed: opened where it is worked with, not in every process on its way.

    reader ── PackedCnf: the names, and the rest as bytes ──► service ── as it is ──► solver: opened
    (a process)                                                                       (another)

A million clauses take the interpreter's lock for a third of a second when they are unpickled, and nothing
else runs in that time. So the service holds bytes and passes them on. It asks a packed description for its
names only; whoever asks for more opens it.
"""

from __future__ import annotations

import pickle
from collections.abc import Callable, Mapping
from typing import Any

from robomend.model.clauses import Assertion, extend, without_running
from robomend.model.cnf import HealthCnf
from robomend.model.formulas import Formula

INLINE_CLAUSES = 5_000
"""Up to so many, a system description is as it is: unpickled, or given to a solver, in some milliseconds."""

INLINE_STEPS = 200
"""Steps (robomend.model.budget) of assertions that are made clauses at once: some milliseconds."""

NAMES = ("name", "components", "atoms", "priors", "costs", "circuit", "inputs", "outputs", "partial")


class PackedCnf(HealthCnf):
    """A HealthCnf that is made when somebody asks for more than its names."""

    def __init__(
        self, names: Mapping[str, Any], make: Callable[..., HealthCnf], arguments: tuple[Any, ...]
    ) -> None:
        """`names` are the fields that need no making; `make(*arguments)` gives the whole."""
        self.__dict__.update(names=dict(names), make=make, arguments=arguments, made=None)

    def opened(self) -> HealthCnf:
        """Return the whole; made once."""
        made: HealthCnf | None = self.__dict__["made"]
        if made is None:
            made = self.__dict__["made"] = self.__dict__["make"](*self.__dict__["arguments"])
        return made

    def __reduce__(self) -> tuple[Any, ...]:
        """Travel packed, whether or not it was opened here."""
        return PackedCnf, (self.__dict__["names"], self.__dict__["make"], self.__dict__["arguments"])

    def __eq__(self, other: object) -> bool:
        return isinstance(other, HealthCnf) and self.opened() == opened(other)

    __hash__ = None  # type: ignore[assignment]  # as of HealthCnf, which holds dictionaries


def _field(name: str) -> property:
    def get(self: PackedCnf) -> Any:
        names: dict[str, Any] = self.__dict__["names"]
        return names[name] if name in names else getattr(self.opened(), name)

    return property(get)


for _name in HealthCnf.__dataclass_fields__:
    setattr(PackedCnf, _name, _field(_name))


def packed(cnf: HealthCnf) -> HealthCnf:
    """Return the system description as it is to travel: packed, if it is large."""
    if len(cnf.clauses) <= INLINE_CLAUSES:
        return cnf
    names = {name: getattr(cnf, name) for name in NAMES}
    return PackedCnf(names, pickle.loads, (pickle.dumps(cnf),))


def opened(cnf: HealthCnf) -> HealthCnf:
    """Return the system description whole."""
    return cnf.opened() if isinstance(cnf, PackedCnf) else cnf


def supposed(cnf: HealthCnf, stopped: tuple[str, ...], assertions: tuple[Assertion, ...]) -> HealthCnf:
    """Return the system description with components that are meant to be stopped, and with assertions.

    What is large is left packed, for whoever diagnoses to make.
    """
    if not stopped and not assertions:
        return cnf
    steps = sum(assertion.steps for assertion in assertions)
    if not isinstance(cnf, PackedCnf) and steps <= INLINE_STEPS:
        return _supposed(cnf, stopped, assertions)
    names = {name: getattr(cnf, name) for name in NAMES if name != "atoms"}
    return PackedCnf(names, _supposed, (cnf, stopped, assertions))


def _supposed(cnf: HealthCnf, stopped: tuple[str, ...], assertions: tuple[Assertion, ...]) -> HealthCnf:
    return extend(without_running(opened(cnf), stopped), assertions)


class PackedAssertion(Assertion):
    """An assertion whose formula is unpickled when somebody asks for it."""

    __slots__ = ("data",)
    data: bytes

    def __init__(self, name: str, text: str, data: bytes, steps: int) -> None:
        for field, value in (("name", name), ("text", text), ("data", data), ("steps", steps)):
            object.__setattr__(self, field, value)

    @property
    def formula(self) -> Formula:
        """The formula; made each time."""
        formula: Formula = pickle.loads(self.data)
        return formula

    def __reduce__(self) -> tuple[Any, ...]:
        return PackedAssertion, (self.name, self.text, self.data, self.steps)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, PackedAssertion):
            return False
        return (self.name, self.text, self.data) == (other.name, other.text, other.data)

    def __hash__(self) -> int:
        return hash((self.name, self.text))


def packed_assertion(assertion: Assertion) -> Assertion:
    """Return the assertion as it is to travel: packed, if it is large."""
    if assertion.steps <= INLINE_STEPS:
        return assertion
    return PackedAssertion(assertion.name, assertion.text, pickle.dumps(assertion.formula), assertion.steps)
