"""The kind `medkit`: an entity of ros2_medkit is restarted (started, shut down) by its gateway.

    restart_node: {kind: medkit, entities: {lidar: apps/lidar_driver}}
    shutdown_arm: {kind: medkit, transition: shutdown, entities: {arm: components/arm}}

`entities` maps the action's parameter to the entity. The gateway answers when it has accepted; the action is
done when the entity is ready again (for a shutdown: not ready any more).
"""

from __future__ import annotations

import asyncio
import re
from collections.abc import Mapping

from robomend_client.actions import FAILED, OK, Action, ActionResult, Feedback
from robomend_client.bridges.medkit.gateway import Gateway, NoGateway

TRANSITIONS = ("start", "restart", "force-restart", "shutdown", "force-shutdown")
ENTITY = re.compile(r"(apps|components)/[A-Za-z0-9_-]+\Z")
TIMEOUT_S = 5.0
LOOK_S = 0.2
AT_ONCE_S = 2.0
"""An entity that was never seen not ready for so long has restarted faster than one could look."""

WHY = {
    401: "the gateway wants a token: name its variable in token_env",
    403: "the token's role may not do that",
    404: "the gateway does not know the entity",
    409: "the gateway says that it cannot be done now",
    501: "nobody at the gateway can do that to the entity",
}


class Restart:
    """Asks the gateway for a transition."""

    def __init__(
        self,
        name: str,
        entities: Mapping[str, str],
        url: str = "http://localhost:8080/api/v1",
        transition: str = "restart",
        token_env: str | None = None,
    ) -> None:
        """
        Args:
            name: the action, as the plan has it; by default the entry's name.
            entities: the action's parameter → `apps/ID` or `components/ID`.
            url: the gateway's, as far as /api/v1.
            transition: start, restart, force-restart, shutdown or force-shutdown.
            token_env: the variable of the agent's environment that has the gateway's bearer token.
        """
        if transition not in TRANSITIONS:
            raise ValueError(f"transition must be one of {', '.join(TRANSITIONS)}, not {transition!r}")
        if not entities:
            raise ValueError("entities must map a parameter to an entity, e.g. {lidar: apps/lidar_driver}")
        for entity in entities.values():
            if not ENTITY.match(entity):
                raise ValueError(f"entities: {entity!r} is no entity; write apps/ID or components/ID")
        if not url.startswith(("http://", "https://")):
            raise ValueError(f"url must be like http://localhost:8080/api/v1, not {url!r}")
        self.name = name
        self.gives_up = False  # the gateway goes on with it
        self.parameters = (tuple(entities),)
        self._entities = dict(entities)
        self._url = url
        self._transition = transition
        self._token_env = token_env

    async def execute(self, action: Action, feedback: Feedback) -> ActionResult:
        entity = self._entities[action.parameters[0]]
        gateway = Gateway(self._url, self._token_env, TIMEOUT_S)
        try:
            code = await gateway.put(f"/{entity}/status/{self._transition}")
            if code not in (200, 202, 204):
                why = WHY.get(code, "the gateway refuses it")
                return ActionResult(FAILED, f"{action}: {why} ({code})")
            feedback(1, f"{action}: the gateway has accepted")
            await self._done(gateway, entity)
        except NoGateway as error:
            return ActionResult(FAILED, f"{action}: {error}")
        finally:
            await gateway.close()
        return ActionResult(OK, f"{action}: {entity} is {self._wanted}")

    @property
    def _wanted(self) -> str:
        return "notReady" if "shutdown" in self._transition else "ready"

    async def _done(self, gateway: Gateway, entity: str) -> None:
        """Wait for it; the caller bounds that by the action's time-out."""
        was_otherwise = False
        since_s = 0.0
        while True:
            status = (await gateway.get(f"/{entity}/status")).get("status")
            if status != self._wanted:
                was_otherwise, since_s = True, 0.0
            elif was_otherwise or since_s >= AT_ONCE_S or "restart" not in self._transition:
                return
            await asyncio.sleep(LOOK_S)
            since_s += LOOK_S
