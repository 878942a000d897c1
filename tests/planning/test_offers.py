"""What no agent of a robot does is not planned: by action and parameter, and by the host that it is for."""

from __future__ import annotations

from collections.abc import Mapping

from tests.planning.robots import TEDUSAR, texts

from robomend.planning.plan import Plan
from robomend.planning.planning import PlanOptions, plan_for
from robomend.planning.problem import Offer, Offers
from robomend.store.agent_actions import meant_for
from robomend.store.records import AgentAction
from robomend_client.literals import holds

AGENTS = frozenset({"start_node", "stop_node", "calibrate"})


def offers(*agents: Offer, hosts: Mapping[str, str | None] | None = None) -> Offers:
    return Offers(agents, AGENTS, hosts or {})


def says(agent: str, *can: str, host: str | None = None) -> Offer:
    return Offer(agent, host, frozenset(can))


def plan(can: Offers | None) -> Plan:
    return plan_for(TEDUSAR, [holds("running", "hokuyo_node")], ["hokuyo_node"], PlanOptions(offers=can))


def test_what_an_agent_does_to_one_node_only_is_not_planned_for_another() -> None:
    only = offers(says("onboard", "start_node:jaguar_node", "stop_node:jaguar_node"))
    assert texts(plan(only)) == []
    assert "no agent offers it (onboard does start_node of jaguar_node)" in " ".join(plan(only).unreachable)
    both = offers(says("onboard", "start_node:hokuyo_node", "stop_node:hokuyo_node"))
    assert texts(plan(both)) == texts(plan(None)) == ["stop_node(hokuyo_node)", "start_node(hokuyo_node)"]


def test_a_host_has_its_own_agents_and_of_one_that_is_not_heard_nothing_is_known() -> None:
    on_nav: dict[str, str | None] = {"map": "nav_pc"}
    arm = says("arm", "start_node:map", host="arm_pc")
    nav = says("nav", "start_node:goal", host="nav_pc")
    assert offers(arm, hosts=on_nav).why_nobody("start_node", ("map",)) is None
    why = offers(arm, nav, hosts=on_nav).why_nobody("start_node", ("map",))
    assert why == "no agent on nav_pc offers it (nav does start_node of goal)"


def test_only_what_agents_carry_out_and_the_name_alone_of_actions_with_more_parameters() -> None:
    known = offers(says("onboard", "calibrate"))
    assert known.why_nobody("power_up", ("base",)) is None  # the board's
    assert known.why_nobody("calibrate", ("left", "fast")) is None
    assert offers(says("onboard", "calibrate:left")).why_nobody("calibrate", ("left", "fast")) is not None


def test_what_is_planned_is_what_the_queue_hands_out() -> None:
    wanted = (("start_node", ("x",)), ("calibrate", ("l", "r")), ("stop_node", ("x",)))
    agents = [says("a", "start_node:x"), says("b", "calibrate", host="pc"), says("c"), Offer("d", "pc")]
    agents += [says("e", "calibrate:l,r"), says("f", "calibrate:l,x")]
    for agent in agents:
        for name, parameters in wanted:
            action = AgentAction(
                "i", "r1", None, name, parameters, 10.0, 0, 0, None, None, False, None, "", None
            )
            handed = meant_for(action, agent.host, agent.can)
            assert handed == (offers(agent).why_nobody(name, parameters) is None)
