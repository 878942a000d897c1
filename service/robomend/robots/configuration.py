"""What is configured of one robot, as values.

The store keeps the JSON that HTTP puts (checked by robomend.api.schemas); this is what the service reads of
it.

To add a setting of a robot: 1. a field with a default in RobotConfig, here (and in `from_json`, unless it
has the name that HTTP gives it); 2. the same in RobotBody of robomend/api/schemas/robots.py, with what it
may be; 3. its row in docs/http.md. tests/robots/test_configuration.py holds the three against each other.
Where it takes effect it is read from a robot's `config`; what repair may do, from the Policy that
`policy_of` makes of that.
The schema in examples/ follows from these; `./dev check --fix` writes it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields
from typing import Any

from robomend.errors import InputError
from robomend.model.components import ComponentModel
from robomend.planning.policy import Limits, Mode, Policy, Window
from robomend.planning.protection import marked, protection
from robomend.redaction import COVERED, SECRET, shown_url


@dataclass(frozen=True, slots=True)
class ExpectedCurrent:
    """What a channel's load draws when all is well."""

    current_a: float
    tolerance_a: float


@dataclass(frozen=True, slots=True)
class BoardConfig:
    """Where the robot's power board is, and what must not be done to it."""

    host: str
    port: int
    rate_hz: int = 5  # of the broadcast that we ask for
    protected: tuple[int, ...] = (2,)  # never shut down; channel 2 feeds the paper's PC
    expected_currents: Mapping[int, ExpectedCurrent] = field(default_factory=dict)  # by channel
    control_port: int | None = None  # of an emulated board, where drills plant its faults


@dataclass(frozen=True, slots=True)
class RobotConfig:
    """One robot: its model, how it is diagnosed, and what repair may do."""

    id: str
    model: str
    policy: str = "approve"
    limits: Limits = field(default_factory=Limits)
    allow: tuple[str, ...] | None = None  # action names that may run; None: all that the model offers
    protected: tuple[str, ...] = ()  # components that are never shut down, besides the model's own
    board: BoardConfig | None = None
    expected_stopped: tuple[str, ...] = ()  # components that are meant to be stopped or off
    observed: tuple[str, ...] = ()  # literals that the observers will report, either sign
    observed_timeout_s: float = 30.0
    detection_s: float = 2.5  # what an observer that does not say so needs from a change to its verdict
    hold_s: float = 0.0  # a diagnosis must hold this long before an automatic repair
    debounce_s: float = 0.0  # a diagnosis waits for OBS to be quiet this long, but at most ten times it
    period_s: float | None = None  # diagnose this often, changed or not (the paper's second)
    believe: tuple[str, ...] = ()  # sources that count where they contradict each other, in order
    bad_wins: bool = False  # … else what does not hold
    keep_unknown: bool = False  # keep undeclared names in OBS, unused, instead of refusing them
    engine: str = "sat"
    minimal: str = "subset"
    max_size: int | None = None
    limit: int = 100
    timeout_s: float | None = None  # of a diagnosis; None: the service's own
    planner: str = "pyperplan"
    domain: str | None = None  # the user's own PDDL actions, merged into the repair domain
    actions: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    """Action name -> what differs for it: policy, executor (kind, options), timeout_s, effect_timeout_s,
    retries, idempotent."""
    windows: tuple[Mapping[str, Any], ...] = ()  # automatic repair only inside: weekdays, start, end (UTC)

    @classmethod
    def from_json(cls, robot: str, values: Mapping[str, Any]) -> RobotConfig:
        """Return the configuration that HTTP puts and the store keeps; keys of a newer version are
        skipped.
        """
        options = values.get("diagnosis") or {}
        allow = values.get("allow")
        read = {
            **_fields(cls, values),
            **_fields(cls, options),
            **{
                name: tuple(values.get(name) or ())
                for name in ("protected", "observed", "windows", "believe")
            },
            "id": robot,
            "limits": Limits(**_fields(Limits, values.get("limits") or {})),
            "allow": None if allow is None else tuple(allow),
            "board": _board(values.get("board")),
            "expected_stopped": tuple((values.get("expected") or {}).get("stopped", ())),
            "keep_unknown": values.get("unknown") == "keep",
        }
        return cls(**read)


def covered(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return a configuration as it is shown: without secrets, for answers, the audit log and exports."""
    return _with_options(values, lambda _action, name, value: _shown(name, value))


def uncovered(values: Mapping[str, Any], before: Mapping[str, Any]) -> dict[str, Any]:
    """Return a configuration with what the one before had where it is covered.

    A secret stays with its receiver: where the kind of the executor or an address changes, it is not known.

    Raises:
        InputError: something covered stands for nothing.
    """
    earlier = before.get("actions") or {}

    def known(action: str, name: str, value: Any) -> Any:
        if not isinstance(value, str) or COVERED not in value:
            return value
        if _receiver(values["actions"][action]) == _receiver(earlier.get(action)):
            found = _options_of(earlier.get(action)).get(name)
            if found is not None and _shown(name, found) == value:
                return found
        where = f"actions.{action}.executor.options.{name}"
        raise InputError(
            f"{where}: {value!r} stands for nothing that is known for this receiver; write it anew"
        )

    return _with_options(values, known)


def _shown(name: str, value: Any) -> Any:
    """Return an executor's option as it is shown."""
    if SECRET.search(name):
        return COVERED
    return shown_url(value) if isinstance(value, str) else value


def _receiver(action: Mapping[str, Any] | None) -> tuple[Any, tuple[tuple[str, Any], ...]]:
    """Return whom an action's executor tells: its kind and addresses, as they are shown."""
    kind = ((action or {}).get("executor") or {}).get("kind")
    options = _options_of(action).items()
    addresses = [
        (name, shown_url(value)) for name, value in options if isinstance(value, str) and "://" in value
    ]
    return kind, tuple(sorted(addresses))


def _with_options(values: Mapping[str, Any], value_of: Callable[[str, str, Any], Any]) -> dict[str, Any]:
    """Return a configuration with its executors' options replaced by `value_of(action, name, value)`."""
    actions = dict(values.get("actions") or {})
    for action, configured in actions.items():
        options = _options_of(configured)
        if options:
            new = {name: value_of(action, name, value) for name, value in options.items()}
            actions[action] = {**configured, "executor": {**configured["executor"], "options": new}}
    return {**values, "actions": actions} if actions else dict(values)


def _options_of(action: Mapping[str, Any] | None) -> Mapping[str, Any]:
    return ((action or {}).get("executor") or {}).get("options") or {}


def _fields(kind: type[RobotConfig | BoardConfig | Limits], values: Mapping[str, Any]) -> dict[str, Any]:
    """Return those of the values that are fields of `kind`, by their names."""
    return {name: values[name] for name in (one.name for one in fields(kind)) if name in values}


def _board(values: Mapping[str, Any] | None) -> BoardConfig | None:
    if values is None:
        return None
    currents = values.get("expected_currents") or {}
    read = {
        **_fields(BoardConfig, values),
        "protected": tuple(values.get("protected", (2,))),
        "expected_currents": {
            int(channel): ExpectedCurrent(**current) for channel, current in currents.items()
        },
    }
    return BoardConfig(**read)


def protected_of(config: RobotConfig, parts: ComponentModel | None) -> tuple[str, ...]:
    """Return the components that a robot protects: by its model, its board's channels, its configuration."""
    if parts is None:
        return ()
    known = set(config.protected).intersection(parts.components)
    return tuple(sorted(known | marked(parts, () if config.board is None else config.board.protected)))


def protection_of(config: RobotConfig, parts: ComponentModel | None) -> dict[str, str]:
    """Return all that nothing switches off or stops on this robot, and why (robomend.planning.protection)."""
    return {} if parts is None else protection(parts, protected_of(config, parts))


def policy_of(config: RobotConfig, parts: ComponentModel | None) -> Policy:
    """Return the policy that a robot's configuration describes, with what its model protects."""
    modes = {name: Mode(value["policy"]) for name, value in config.actions.items() if value.get("policy")}
    return Policy(
        mode=Mode(config.policy),
        actions=modes,
        allowed=None if config.allow is None else frozenset(config.allow),
        protected=protection_of(config, parts),
        limits=config.limits,
        hold_s=config.hold_s,
        windows=tuple(map(Window.of, config.windows)),
    )
