"""What a robot's agents offer to do, as far as this instance can know; by its model, who acts on what."""

from __future__ import annotations

from collections.abc import Iterable

from robomend.model.components import ComponentModel
from robomend.planning.offers import Offer, Offers
from robomend.repairs.executors.registry import kind_of
from robomend.robots.robot import Robot
from robomend.store import Store


def hosts_of(parts: ComponentModel) -> dict[str, str | None]:
    """Return component -> the host whose agents act on it; None: any of the robot's."""
    return {name: part.host for name, part in parts.parts.items()}


def offers_of(state: Robot, parts: ComponentModel, actions: Iterable[str]) -> Offers:
    """Return what the agents say that are heard now.

    Args:
        actions: the names of the robot's domain's.
    """
    by_agents = (name for name in actions if kind_of(name, state.config.actions)[0] == "agent")
    said = (Offer(each.agent, each.host, each.can) for each in state.sight.declared.agents())
    return Offers(tuple(said), frozenset(by_agents), hosts_of(parts))


async def offers_if_all(
    state: Robot, parts: ComponentModel, actions: Iterable[str], store: Store
) -> Offers | None:
    """Return what agents say; None: one may be there of which this instance has not heard.

    That is so where there are others which it may ask for work, and right after a start.
    """
    if not state.sight.declared.all_heard() or len(await store.ownership.instances()) > 1:
        return None
    return offers_of(state, parts, actions)
