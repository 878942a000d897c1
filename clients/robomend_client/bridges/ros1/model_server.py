"""The action `diagnosis_model_server`: the model that the robot follows, as propositions and clauses.

A goal of any text gets it as the result, and whoever listens to /diagnosis_model, too, as with the published
system's model server; its engine asks for it so. The model is the service's: it is asked each time.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from robomend_client.actions import OK, REFUSED, UNREACHABLE, ActionResult
from robomend_client.agent.feeds import AgentParts
from robomend_client.bridges.fields import UnreadableMessage
from robomend_client.bridges.ros1 import formats
from robomend_client.bridges.ros1.action_server import Goal, GoalServer
from robomend_client.bridges.ros1.messages import MessageReaders
from robomend_client.bridges.ros1.node import RosNode
from robomend_client.bridges.ros1.publication import MessageType, never_said
from robomend_client.bridges.ros1.subscription import Publisher
from robomend_client.rest.errors import ApiError, ClientError

NAME = "diagnosis_model_server"
TOPIC = "diagnosis_model"
KEYS = ("ab", "nab", "neg_prefix", "rules", "props")


class ModelServer(GoalServer):
    """Serves the model."""

    types = {  # noqa: RUF012  # as the base says
        "status": formats.STATUSES,
        "feedback": formats.MODEL_FEEDBACK,  # nothing is ever said there
        "result": formats.MODEL_RESULT,
    }

    def __init__(self, node: RosNode, parts: AgentParts, name: str, topic: str) -> None:
        super().__init__(node, parts, name, topic, _describe)
        self._readers = MessageReaders()
        told = f"{topic.rpartition('/')[0]}/{TOPIC}"
        self._model = node.publish(told, formats.MODEL, formats.message_type, latched=True)

    def read_goal(self, publisher: Publisher, body: bytes) -> Any:
        """Return a goal, by its sender's definition: of what it wants, only that it wants it counts."""
        place = f"{self._name}/goal by {publisher.node}"
        try:
            message = self._readers.open(publisher, body)
            for field in ("id", "stamp.sec", "stamp.nanosec"):
                message.at(f"goal_id.{field}")
        except UnreadableMessage as error:
            self._node.problems.tell(place, f"{publisher.type} is no goal: {error}")
            return None
        return message.whole()

    async def carry_out(self, goal: Goal, wanted: Any) -> tuple[ActionResult, Mapping[str, object] | None]:
        try:
            found = await self._parts.client.followed_model(self._parts.robot)
        except ApiError as error:
            return ActionResult(REFUSED, f"{self._name}: {error}"), None
        except ClientError as error:
            return ActionResult(UNREACHABLE, f"{self._name}: {error}"), None
        value = {key: dict(found)[key] for key in KEYS}
        if self._model.wanted:
            self._model.publish(formats.encode(formats.MODEL, value))
        return ActionResult(OK, f"the model {found['model']}, {len(found['rules'])} clauses"), value


def _describe(name: str) -> MessageType:
    return never_said(name) if name == formats.MODEL_FEEDBACK else formats.message_type(name)
