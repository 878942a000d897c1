"""What the drills of all robots share."""

from __future__ import annotations

from dataclasses import dataclass

from robomend.repairs.agent_queue import AgentQueue
from robomend.repairs.repair_json import repair_json
from robomend.repairs.stop_switch import StopSwitch
from robomend.robots.robots import Robots
from robomend.settings import Settings
from robomend.store import Store, Transaction
from robomend.store.records import AuditEntry, StoredRepair
from robomend_client.events import Kind


@dataclass(frozen=True)
class DrillParts:
    """See the module."""

    store: Store
    robots: Robots
    agents: AgentQueue
    switch: StopSwitch
    settings: Settings

    def tell_cancelled(self, tx: Transaction, repair: StoredRepair, why: str) -> None:
        """Tell the repair's owner, and the audit log, that it is asked to end."""
        asked = {**repair_json(repair), "asked": "cancel", "asked_by": "robomend"}
        tx.emit(Kind.REPAIR, repair.robot, asked)
        tx.note(AuditEntry("robomend", "repair.cancel", repair.id, repair.robot, why))
