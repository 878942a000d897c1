"""The exceptions that callers of the service may catch.

RobomendError
├── InputError                     what came in is at fault; commands exit with 2, HTTP answers 4xx
│   ├── ModelError                 the system description is at fault
│   │   ├── UnknownComponent
│   │   └── ContradictoryModel     SD ∪ OBS has no model, even with every component abnormal
│   ├── ObservationError           a sentence is malformed, or names what the model does not declare
│   ├── DomainError                a PDDL domain or the user's part of it is at fault
│   ├── MalformedJson              no JSON, or what no part of the service could hold
│   ├── TooDeep                    JSON nested deeper than allowed
│   ├── OptionRefused              an engine or planner that cannot honour an option
│   ├── TooLarge                   more than a limit of the service allows
│   ├── NotFound                   no such robot, model, repair, …
│   ├── StateConflict              the resource is not in the state that the request needs
│   │   └── Fenced                 another instance has taken over the robot
│   ├── PreconditionFailed         If-Match names another version
│   ├── PreconditionRequired       the change needs If-Match
│   └── Refused                    policy, protection or role says no
└── BackendError                   a part behind us failed; commands exit with 3, HTTP answers 5xx
    ├── SolverError                SAT, ASP or planner crashed or refused its input
    ├── WorkerDied                 a worker process ended in the middle of a call
    ├── WorkerTimeout              a worker process was killed at the deadline of its call
    ├── WorkerNotReady             none was, long after its start
    ├── Overloaded                 too many requests wait for something
    ├── StoreError                 the database is gone
    │   ├── StoreFull              the disk is full: reading goes on
    │   ├── StoreDamaged           the database file is damaged
    │   └── StoreOverloaded        too much is waiting to be written
    └── BoardError                 the power board or the link is at fault
        ├── BoardTimeout
        ├── BoardUnreachable
        ├── BoardRefused           the board's acknowledge code was not 0
        ├── LocalProtocolError     we broke the protocol: a bug on our side
        └── RemoteProtocolError    the peer broke the protocol

"Healthy", "no plan" and "out of time" are answers, not errors. Every error pickles (workers send them), has a
`code` that HTTP clients may rely on, and a message that names the place and the remedy.
"""

from __future__ import annotations

from robomend_client.near import did_you_mean


class RobomendError(Exception):
    """The root of all of them."""

    code = "internal"


class InputError(RobomendError):
    """What came in is at fault."""

    code = "bad-input"


class _WithPlace(Exception):
    """At fault is a line of a file."""

    def __init__(self, message: str, file: str | None = None, line: int | None = None) -> None:
        super().__init__(message, file, line)
        self.message = message
        self.file = file
        self.line = line

    def __str__(self) -> str:
        place = ":".join(str(part) for part in (self.file, self.line) if part is not None)
        return f"{place}: {self.message}" if place else self.message


class ModelError(_WithPlace, InputError):
    """A system description at fault, with its place: file, line (from 1) and what is allowed.

    `str(error)` reads `tedusar.yaml:12: channel 7 is used twice (jaguar, hokuyo); give each its own`.
    """

    code = "bad-model"


class UnknownComponent(ModelError):
    """A name that is no component of the model."""

    code = "unknown-component"

    def __init__(
        self, name: str, known: frozenset[str], file: str | None = None, line: int | None = None
    ) -> None:
        super().__init__(f"no component is named {name!r}{did_you_mean(name, known)}", file, line)
        self.args = (name, known, file, line)


class ContradictoryModel(ModelError):
    """SD ∪ OBS has no model, even with every component abnormal.

    `literals` are observations that clash, `rules` the rules they clash with (both as text; a small set, not
    always the smallest).
    """

    code = "contradictory-model"

    def __init__(self, literals: tuple[str, ...] = (), rules: tuple[str, ...] = ()) -> None:
        if literals:
            with_rules = f" contradicts the rules {'; '.join(rules)}" if rules else " is contradictory"
            clash, remedy = " and ".join(literals) + with_rules, "mend the rule, or withdraw the observation"
        else:
            clash = f"without any observation, the rules contradict one another: {'; '.join(rules)}"
            remedy = "mend one of them"
        super().__init__(f"{clash}, whatever is abnormal: {remedy}")
        self.literals = literals
        self.rules = rules
        self.args = (literals, rules)


class ObservationError(InputError):
    """A sentence that cannot be read, or names what the model does not declare; position is 0-based."""

    code = "bad-observation"

    def __init__(self, message: str, sentence: str, position: int = 0) -> None:
        super().__init__(message, sentence, position)
        self.message = message
        self.sentence = sentence
        self.position = position

    def __str__(self) -> str:
        return f"{self.sentence!r}, position {self.position}: {self.message}"


class DomainError(_WithPlace, InputError):
    """A PDDL domain, or the user's part of it, at fault; line from 1."""

    code = "bad-domain"


class MalformedJson(InputError):
    """No JSON, or not in UTF-8."""

    code = "malformed-json"


class TooDeep(InputError):
    """JSON nested deeper than allowed."""

    code = "too-deep"


class OptionRefused(InputError):
    """An engine or planner that cannot honour an option says so, rather than ignoring it."""

    code = "option-refused"


class TooLarge(InputError):
    """More than a limit of the service allows."""

    code = "too-large"


class NotFound(InputError):
    """No such robot, model, repair, …"""

    code = "not-found"


class StateConflict(InputError):
    """The resource is not in the state that the request needs."""

    code = "conflict"


class Fenced(StateConflict):
    """A write with an old fencing number: another instance has taken over the robot. Let go of it at once."""

    code = "fenced"


class PreconditionFailed(InputError):
    """If-Match names another version than the current one."""

    code = "precondition-failed"


class PreconditionRequired(InputError):
    """Replacing a resource needs If-Match with its current ETag."""

    code = "precondition-required"


class Refused(InputError):
    """Policy, protection or role says no."""

    code = "refused"


class BackendError(RobomendError):
    """A part behind us failed."""

    code = "backend-failed"


class SolverError(BackendError):
    """SAT, ASP or planner crashed or refused its input."""

    code = "solver-failed"


class WorkerDied(BackendError):
    """A worker process ended in the middle of a call."""

    code = "worker-died"


class WorkerTimeout(BackendError):
    """A worker process was killed at the deadline of its call."""

    code = "worker-timeout"


class WorkerNotReady(BackendError):
    """No worker process was ready for a call, long after its start."""

    code = "worker-not-ready"


class Overloaded(BackendError):
    """Too many requests wait for something already; try again later."""

    code = "overloaded"


class StoreError(BackendError):
    """The database is gone or refuses to work."""

    code = "store-unavailable"


class StoreFull(StoreError):
    """The disk is full: writes are refused, reading goes on."""

    code = "store-full"


class StoreDamaged(StoreError):
    """The database file is damaged, or a part of it is missing: a copy has to take its place."""

    code = "store-damaged"


class StoreOverloaded(StoreError):
    """Too much is waiting to be written: try again in a moment."""

    code = "store-overloaded"


class BoardError(BackendError):
    """The power board or the link to it is at fault."""

    code = "board-failed"


class BoardTimeout(BoardError):
    """The board did not answer in time: whether it acted is unknown."""

    code = "board-timeout"


class BoardUnreachable(BoardError):
    """There is no connection to the board."""

    code = "board-unreachable"


class BoardRefused(BoardError):
    """The board's acknowledge code was not 0."""

    code = "board-refused"


class LocalProtocolError(BoardError):
    """We broke the protocol: a bug on our side."""

    code = "board-local-protocol"


class RemoteProtocolError(BoardError):
    """The peer broke the protocol: the connection must be dropped."""

    code = "board-remote-protocol"
