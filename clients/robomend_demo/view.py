"""The robot as a client of the service sees it, event by event. Pure: events in, state out."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from typing import Any

from robomend_client.events import Event, Kind
from robomend_demo.record import FINAL


@dataclass(frozen=True, slots=True)
class Act:
    """A step of a plan that was begun."""

    text: str
    state: str
    sent_ns: int | None
    ended_ns: int | None
    message: str = ""


@dataclass
class RobotView:
    """Everything that the events so far say of one robot."""

    robot: str
    observed: Collection[str]  # atoms that the observers report
    obs: dict[str, bool] = field(default_factory=dict)
    diagnoses: tuple[tuple[str, ...], ...] | None = None  # the bad sets; None: not diagnosed yet
    repair: Mapping[str, Any] | None = None  # the latest one
    acts: dict[tuple[str, int], Act] = field(default_factory=dict)
    board: str = "connecting"

    def take(self, event: Event) -> None:
        """Take in what an event says."""
        if event.robot != self.robot:
            return
        data = event.data
        match event.kind:
            case Kind.OBSERVATIONS:
                for literal in data["changed"]:
                    self.obs[literal.removeprefix("not ")] = not literal.startswith("not ")
                for atom in data["forgotten"]:
                    self.obs.pop(atom, None)
            case Kind.DIAGNOSIS:
                result = data["result"]
                found = None if result is None else result["diagnoses"]
                self.diagnoses = None if found is None else tuple(tuple(one["bad"]) for one in found)
            case Kind.REPAIR:
                self.repair = data
            case Kind.BOARD if "link" in data:
                self.board = data["link"]
            case Kind.ACTION if "repair" in data:
                self.acts[data["repair"], data["index"]] = Act(
                    data["text"], data["state"], data["sent_ns"], data["ended_ns"], data["message"]
                )

    @property
    def suspects(self) -> frozenset[str] | None:
        """The components that some minimal diagnosis blames; None before the first diagnosis."""
        if self.diagnoses is None:
            return None
        return frozenset(name for bad in self.diagnoses for name in bad)

    @property
    def blamed(self) -> frozenset[str]:
        """The components that every minimal diagnosis blames."""
        return frozenset.intersection(*map(frozenset, self.diagnoses)) if self.diagnoses else frozenset()

    @property
    def healthy(self) -> bool:
        """Every observer says that all is well, and so does the diagnosis."""
        return self.suspects == frozenset() and all(self.obs.get(atom) for atom in self.observed)

    @property
    def unheard(self) -> list[str]:
        """What no observer has said anything about yet."""
        return [atom for atom in self.observed if atom not in self.obs]

    @property
    def repairing(self) -> bool:
        """A repair is open."""
        return self.repair is not None and self.repair["state"] not in FINAL
