"""The scenarios, played against a robot of real processes; the first two are the paper's (section VI).

    power-up     all off, nothing runs ──► the robot is entrusted to the service ──► all good and verified
    shut-down    all good ──► the tracked base loses its power ──► all good and verified
    hung-device  all good ──► the laser range finder says nothing until its power is cut ──► the same
    dead-lidar   all good ──► the laser range finder says nothing any more ──► the same, with its spare

Nothing here repairs anything: the service does. This only brings the robot into its state, and watches.
"""

from __future__ import annotations

import contextlib
import queue
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future
from pathlib import Path
from typing import TypeVar

from robomend.cli.interrupts import Interrupts
from robomend.cli.stage import PartFailed, Stage, tail
from robomend_client.events import Kind
from robomend_client.rest.calls import post
from robomend_client.rest.errors import ClientError
from robomend_client.rest.retry import NEVER
from robomend_client.rest.sync import Client
from robomend_demo.cast import (
    READY_S,
    ROBOT,
    Cast,
    observed,
    robot_config,
    start_agent,
    wait_for_devices,
)
from robomend_demo.devices import DeviceFault
from robomend_demo.record import Heard, Record, record
from robomend_demo.scenarios import DEAD_LIDAR, HUNG_DEVICE, POWER_UP, SHUT_DOWN, Scenario
from robomend_demo.screen import RobotView, Screen

# --- follows the service's events on a thread, so that each has the time at which it came.


class Listener:
    """Hears everything from the beginning of the service's log. It ends when the service does."""

    def __init__(self, url: str) -> None:
        self._url = url
        self._heard: queue.SimpleQueue[Heard] = queue.SimpleQueue()
        self._thread = threading.Thread(target=self._listen, name="events", daemon=True)
        self.lost: str | None = None

    def start(self) -> None:
        """Begin; no process may be forked from here on."""
        self._thread.start()

    def take(self) -> list[Heard]:
        """Return what came since the last time."""
        heard = []
        while not self._heard.empty():
            heard.append(self._heard.get_nowait())
        return heard

    def close(self, timeout_s: float = 1.0) -> None:
        """Wait for the thread, which ends with its connection."""
        if self._thread.ident is not None:
            self._thread.join(timeout_s)

    def _listen(self) -> None:
        try:
            with Client(self._url, timeout_s=5.0, retry=NEVER) as client:
                for event in client.events(after=0, patience_s=0.0):
                    self._heard.put(Heard(event, time.time_ns()))
        except ClientError as error:
            self.lost = str(error)


T = TypeVar("T")

CONNECTED_S = 10.0

HEALTHY_S = 30.0
"""For the robot to be up and well before its power is taken away."""

REPAIR_S = 90.0
"""For a scenario; a healthy machine takes 2 s to 6 s."""

SETTLED_S = 1.0
"""A repair counts when nothing came up again for this long."""

HISTORY_PAGE = 200


class Play:
    """One robot, from its first observation to its last repair."""

    def __init__(
        self,
        stage: Stage,
        cast: Cast,
        interrupts: Interrupts,
        screen: Screen,
    ) -> None:
        self.cast = cast
        self._stage = stage
        self._interrupts = interrupts
        self._screen = screen
        self._client = Client(cast.url, timeout_s=5.0, retry=NEVER)
        self._listener = Listener(cast.url)
        self._observed = observed(cast.robot.model)
        self._view = RobotView(ROBOT, self._observed)
        self._heard: list[Heard] = []
        self._unheard: list[str] = []
        self._version = ""

    def close(self) -> None:
        """Drop the connections; call it when the service has ended."""
        self._client.close()
        self._listener.close()

    # --- scenarios ---------------------------------------------------------------------------------

    def prepare(self, folder: Path, *, all_on: bool) -> None:
        """Start the agent; if all is on, bring the robot to where it works. Nothing is repaired yet."""
        if all_on:
            wait_for_devices(self.cast, self._interrupts, HEALTHY_S)
        self._warm_up()
        self._version = self._entrust("observe", None)
        start_agent(self._stage, folder, self.cast, start_nodes=all_on)
        self._listener.start()  # a thread: nothing is forked any more
        self._until(lambda: bool(self._heard), CONNECTED_S, "the service's events")
        if all_on:
            self._until(lambda: self._view.healthy, HEALTHY_S, "the robot to be up and well")
            self._entrust("auto", self._version)

    def play(self, scenario: Scenario) -> Record:
        """Let it happen, watch how it is repaired, and show the service's account of that."""
        if scenario is not POWER_UP:
            self._until(lambda: self._view.healthy, HEALTHY_S, "the robot to be well")
        zero_ns = self._begin(scenario.name)
        happens: dict[Scenario, Callable[[str], None]] = {
            POWER_UP: self._entrust_it,
            SHUT_DOWN: self._take_power,
            HUNG_DEVICE: lambda device: self.cast.devices.plant(device, DeviceFault.HUNG),
            DEAD_LIDAR: lambda device: self.cast.devices.plant(device, DeviceFault.DEAD),
        }
        happens[scenario](scenario.victim)
        self._until(lambda: self._settled(zero_ns), REPAIR_S, f"{scenario.name} to end")
        account = self._account(zero_ns)
        self._screen.account(account)
        return record(scenario.name, zero_ns, self._heard, self._history(zero_ns), self._unheard, account)

    def hold(self) -> None:
        """Go on showing what happens, until a signal comes."""
        self._screen.scene("hold", time.time_ns(), self._view)
        while True:
            self._look()
            self._interrupts.wait(0.05)

    # --- inside ------------------------------------------------------------------------------------

    def _entrust_it(self, _: str) -> None:
        self._entrust("auto", self._version)

    def _take_power(self, device: str) -> None:
        channel = self.cast.robot.model.hardware[device].channel
        assert channel is not None
        self.cast.board.set_channel(channel, False)

    def _warm_up(self) -> None:
        """Let the service plan something once: a planner is slow the first time, and robots come later."""
        question = {"model": self.cast.robot.model.name, "bad": [POWER_UP.victim]}

        with contextlib.suppress(ClientError):  # the repair will tell what is wrong
            self._patiently(lambda client: client.send(post("plans", json=question)))

    def _patiently(self, ask: Callable[[Client], T]) -> T:
        """Ask for what may take a busy computer long; a signal, or a part that ends, is seen meanwhile."""
        answer: Future[T] = Future()

        def run() -> None:
            try:
                with Client(self.cast.url, timeout_s=READY_S, retry=NEVER) as client:
                    answer.set_result(ask(client))
            except ClientError as error:
                answer.set_exception(error)

        thread = threading.Thread(target=run, name="asks", daemon=True)
        thread.start()
        look = self._interrupts.poll(2 * READY_S)
        while thread.is_alive() and look.left():
            self._stage.check()
        thread.join(1.0)
        if not answer.done():
            raise PartFailed(f"the service gave no answer within {2 * READY_S:g} s; {self._logs('service')}")
        return answer.result()

    def _begin(self, name: str) -> int:
        """Begin a scenario; return its time zero."""
        self._look()
        self._unheard = self._view.unheard
        zero_ns = time.time_ns()
        self._screen.scene(name, zero_ns, self._view)
        return zero_ns

    def _entrust(self, policy: str, version: str | None) -> str:
        """Tell the service of the robot, and how far it may go."""
        config = robot_config(self.cast.robot, self.cast.board, policy=policy)
        # A domain of the robot's own is checked in a process that has to start first.
        return self._patiently(lambda client: client.put_robot(ROBOT, config, version)).version

    def _settled(self, zero_ns: int) -> bool:
        repair = self._view.repair
        if repair is None or repair["created_ns"] < zero_ns or self._view.repairing:
            return False
        if repair["state"] != "repaired":
            ended = f"the repair ended as {repair['state']!r}: {repair['reason']}"
            raise PartFailed(f"{ended}; {self._logs('agent', 'service')}")
        quiet_s = (time.time_ns() - repair["finished_ns"]) / 1e9
        return self._view.healthy and bool(repair["rounds"]) and quiet_s >= SETTLED_S

    def _until(self, condition: Callable[[], bool], timeout_s: float, what: str) -> None:
        """Watch until the condition holds.

        Raises:
            PartFailed: it does not in time, or a part ended; says what is known and shows the right log.
        """
        look = self._interrupts.poll(timeout_s)
        while look.left():
            self._look()
            if condition():
                return
        raise PartFailed(f"waited {timeout_s:g} s for {what}: {self._known()}")

    def _look(self) -> None:
        for heard in self._listener.take():
            self._heard.append(heard)
            self._view.take(heard.event)
            self._screen.heard(heard.event, self._view)
        self._screen.refresh(self._view)
        self._stage.check()
        if self._listener.lost is not None:
            raise PartFailed(f"the service's events ended: {self._listener.lost}; {self._logs('service')}")

    def _known(self) -> str:
        view = self._view
        if view.board != "connected":
            return f"the service's link to the board is {view.board!r}; {self._logs('board', 'service')}"
        if view.unheard:
            actor = "board" if all(atom.startswith("on(") for atom in view.unheard) else "agent"
            return f"nobody reported {', '.join(view.unheard)}; {self._logs(actor)}"
        if view.repairing and view.repair is not None:
            why = f"{view.repair['state']!r}: {view.repair['reason']}"
            return f"the repair is still {why}; {self._logs('agent', 'service')}"
        wrong = [f"not {atom}" for atom in view.observed if not view.obs[atom]]
        return f"observed is {', '.join(wrong) or 'nothing wrong'}; {self._logs('agent')}"

    def _logs(self, *names: str) -> str:
        ends = [f"the log of {name} ends:\n{tail(self.cast.actors[name].log)}" for name in names]
        return "\n".join(ends)

    def _account(self, zero_ns: int) -> list[str]:
        """Return the service's account of each repair since then, the first one first."""
        repairs = {
            heard.event.data["id"]: None
            for heard in self._heard
            if heard.event.kind is Kind.REPAIR and heard.event.data["created_ns"] >= zero_ns
        }
        return [line for id in repairs for line in self._client.repair(id)["account"]]

    def _history(self, zero_ns: int) -> list[dict[str, object]]:
        """Return the accepted batches since then, which tell when each literal was observed."""
        lines: list[dict[str, object]] = []
        cursor: str | None = None
        while True:
            page = self._client.history(ROBOT, "observations", cursor=cursor, limit=HISTORY_PAGE)
            lines.extend(line for line in page["items"] if line["time_ns"] >= zero_ns)
            cursor = page["next"]
            if cursor is None or not page["items"] or page["items"][-1]["time_ns"] < zero_ns:
                return lines
