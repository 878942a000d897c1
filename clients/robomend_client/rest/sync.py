"""The REST client for threads.

    with Client("http://127.0.0.1:8080") as client:
        client.observe("tedusar", ["not ok(scan)"])

Every method sends one call of calls.py. retry.py says what is sent again and when, errors.py what is raised,
transport.py what is on the wire.
"""

# Made from robomend_client/rest/asynchronous.py by make_sync.py: change that one.

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from types import TracebackType
from typing import IO, Any, TypeVar

import httpx

from robomend_client.actions import Action, ActionResult
from robomend_client.events import Event
from robomend_client.readings import Reading
from robomend_client.rest import calls
from robomend_client.rest.calls import Call, Versioned
from robomend_client.rest.errors import (
    ApiError,
    ClientError,
    ServiceFailed,
    TooManyRequests,
    raise_for,
    translate,
)
from robomend_client.rest.retry import Attempts, Retry
from robomend_client.rest.transport import Connection, StreamState
from robomend_client.rest.types import (
    Accepted,
    Board,
    CurrentDiagnosis,
    FirstResult,
    FiveKeys,
    HistoryKind,
    Ingested,
    Obs,
    Page,
    Probes,
    Result,
    Status,
    Stop,
)

T = TypeVar("T")
S = TypeVar("S", bound="Client")


class Client:
    """The service at `url`, e.g. http://127.0.0.1:8080, with the bearer key `key` if it asks for one.

    `timeout_s` bounds each wait for the service (a long poll adds its own `wait_s`), `retry` how often a call
    is repeated. Proxies of the environment are not used unless `trust_env` says so: a robot talks to its own
    network.
    """

    def __init__(
        self,
        url: str,
        key: str | None = None,
        *,
        timeout_s: float = 30.0,
        retry: Retry | None = None,
        trust_env: bool = False,
        transport: httpx.BaseTransport | None = None,
    ) -> None:
        self._connection = Connection(url, key, timeout_s, trust_env)
        self._retry = retry or Retry()
        self._http = httpx.Client(transport=transport, **self._connection.options())

    def __enter__(self: S) -> S:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Close the connections; open event streams end."""
        self._http.close()

    def send(self, call: Call[T], retry: Retry | None = None) -> T:
        """Send one call and read its answer."""
        attempts = Attempts(retry or self._retry, call.repeatable)
        while True:
            try:
                response = self._http.request(**self._connection.request(call))
                raise_for(response)
                return call.read(response)
            except httpx.TransportError as error:
                failure: ClientError = translate(error)
                failure.__cause__ = error
            except ApiError as error:
                failure = error
            time.sleep(attempts.after(failure))

    def download(self, call: Call[Any], into: IO[bytes]) -> None:
        """Send one call, once, and write its answer piece by piece."""
        try:
            with self._http.stream(**self._connection.request(call)) as response:
                if response.status_code != 200:
                    response.read()
                    raise_for(response)
                for data in response.iter_bytes():
                    into.write(data)
        except httpx.TransportError as error:
            raise translate(error) from error

    def events(
        self,
        robot: str | None = None,
        *,
        after: int | str | None = None,
        patience_s: float | None = None,
        on_gap: Callable[[Mapping[str, Any]], None] | None = None,
        on_connection: Callable[[ClientError | None], None] | None = None,
    ) -> Iterator[Event]:
        """Yield the events of one robot, or of the whole service, for ever:
        from now on, or after event `after`.

        A lost stream is taken up again with Last-Event-ID, so that nothing is missed that the service still
        keeps; when it does not, `on_gap` is told. `on_connection` is told with None that the stream stands,
        and with the reason that it is lost. After `patience_s` without a connection (None: never) the reason
        is raised.
        """
        stream = StreamState(robot, after, patience_s, on_gap, on_connection)
        while True:
            try:
                with self._http.stream(**self._connection.stream(stream)) as response:
                    if response.status_code != 200:
                        response.read()
                        raise_for(response)
                    stream.connected(response)
                    for data in response.iter_bytes():
                        yield from stream.receive(data)
                failure: ClientError = stream.ended()
            except httpx.TransportError as error:
                failure = translate(error)
                failure.__cause__ = error
            except (ServiceFailed, TooManyRequests) as error:
                failure = error
            time.sleep(stream.after(failure))

    # --- all robots ---------------------------------------------------------------------------------

    def status(self, search: str = "", *, state: str = "", page: int = 1, rows: int | None = None) -> Status:
        """Return how every robot is, what is wrong and what it waits for, the most urgent first."""
        answer: Status = self.send(calls.get("status", q=search, state=state, page=page, rows=rows))
        return answer

    # --- models and robots -------------------------------------------------------------------------

    def models(self, cursor: str | None = None, limit: int | None = None) -> Page[dict[str, Any]]:
        """Return the models that the service holds."""
        return self.send(calls.page("models", cursor=cursor, limit=limit))

    def model(self, name: str) -> Versioned:
        """Return a model and its version."""
        return self.send(calls.get_versioned("models", name))

    def put_model(
        self, name: str, source: str, *, format: str | None = None, version: str | None = None
    ) -> Versioned:
        """Store a model, as the text of its file; replacing one needs the version that is replaced."""
        return self.send(calls.put_model(name, source, format, version))

    def delete_model(self, name: str, version: str) -> None:
        """Remove a model that no robot follows."""
        self.send(calls.delete("models", name, version=version))

    def model_versions(
        self, name: str, cursor: str | None = None, limit: int | None = None
    ) -> Page[dict[str, Any]]:
        """Return what the model was, newest first."""
        return self.send(calls.page("models", name, "versions", cursor=cursor, limit=limit))

    def robots(self, cursor: str | None = None, limit: int | None = None) -> Page[dict[str, Any]]:
        """Return the robots that the service looks after."""
        return self.send(calls.page("robots", cursor=cursor, limit=limit))

    def robot(self, robot: str) -> Versioned:
        """Return a robot and its version."""
        return self.send(calls.get_versioned("robots", robot))

    def followed_model(self, robot: str) -> FiveKeys:
        """Return the model that a robot follows, as propositions and clauses."""
        answer: FiveKeys = self.send(calls.get("robots", robot, "model"))
        return answer

    def put_robot(self, robot: str, value: Mapping[str, Any], version: str | None = None) -> Versioned:
        """Store a robot: its model, policy, limits, board, and what its observers will report."""
        return self.send(calls.put_robot(robot, value, version))

    def delete_robot(self, robot: str, version: str) -> None:
        """Remove a robot that no repair is at work on."""
        self.send(calls.delete("robots", robot, version=version))

    # --- observations and diagnosis ----------------------------------------------------------------

    def observe(
        self,
        robot: str,
        observations: calls.Sentences,
        *,
        assertions: Mapping[str, str] | None = None,
        time_ns: int | None = None,
        source: str | None = None,
        lifetime_s: float | None = None,
        together: bool = True,
        key: str | None = None,
        readings: Sequence[Reading | None] | None = None,
    ) -> Accepted:
        """Report observations, e.g. `["not ok(scan)"]`; they are on the service's disk when this returns.

        `readings` runs parallel to them: what was measured, e.g. `Reading(19.1, "V", "at least 22")`.
        """
        return self.send(
            calls.observe(
                robot,
                observations,
                assertions=assertions,
                time_ns=time_ns,
                source=source,
                lifetime_s=lifetime_s,
                together=together,
                key=key,
                readings=readings,
            )
        )

    def observe_lines(
        self,
        robot: str,
        batches: Iterable[Mapping[str, Any]],
        *,
        key: str | None = None,
    ) -> Ingested:
        """Report many batches in one request (NDJSON)."""
        return self.send(calls.observe_lines(robot, batches, key))

    def observations(self, robot: str) -> Obs:
        """Return OBS as it is now."""
        answer: Obs = self.send(calls.get("robots", robot, "observations"))
        return answer

    def withdraw(self, robot: str, assertion: str) -> None:
        """Withdraw a named assertion."""
        self.send(calls.delete("robots", robot, "assertions", assertion))

    def diagnosis(
        self, robot: str, *, wait_s: float | None = None, after: int | None = None
    ) -> CurrentDiagnosis:
        """Return the diagnosis; `wait_s` waits for one newer than `after`, or than the current one."""
        return self.send(calls.diagnosis(robot, wait_s, after))

    def probes(self, robot: str, limit: int | None = None) -> Probes:
        """Return what to look at next, best first."""
        answer: Probes = self.send(calls.get("robots", robot, "probes", limit=limit))
        return answer

    def diagnose(self, question: Mapping[str, Any]) -> Result:
        """Diagnose a model and observations that no robot has (POST /diagnoses): what if?"""
        answer: Result = self.send(calls.post("diagnoses", json=dict(question), repeatable=True))
        return answer

    def isolability(self, model: str, question: Mapping[str, Any] | None = None) -> dict[str, Any]:
        """Return which faults of a model could be told apart (POST /models/{name}/isolability)."""
        call = calls.post("models", model, "isolability", json=dict(question or {}), repeatable=True)
        answer: dict[str, Any] = self.send(call)
        return answer

    # --- repair ------------------------------------------------------------------------------------

    def plan(self, robot: str, *, bad: Sequence[str] | None = None, **options: Any) -> dict[str, Any]:
        """Plan a repair of `bad`, or of the best choice, without acting."""
        answer: dict[str, Any] = self.send(
            calls.post("robots", robot, "plans", json={"bad": bad, **options}, repeatable=True)
        )
        return answer

    def start_repair(
        self, robot: str, *, bad: Sequence[str] | None = None, reason: str = ""
    ) -> dict[str, Any]:
        """Ask for a repair; the policy says whether it waits for a person."""
        answer: dict[str, Any] = self.send(
            calls.post("robots", robot, "repairs", json={"bad": bad, "reason": reason})
        )
        return answer

    def repairs(
        self, robot: str, cursor: str | None = None, limit: int | None = None
    ) -> Page[dict[str, Any]]:
        """Return the robot's repairs, newest first."""
        return self.send(calls.page("robots", robot, "repairs", cursor=cursor, limit=limit))

    def all_repairs(
        self, cursor: str | None = None, limit: int | None = None, *, open_only: bool = False
    ) -> Page[dict[str, Any]]:
        """Return the repairs of all robots, newest first; `open_only`: those that have not ended."""
        only = "true" if open_only else None
        return self.send(calls.page("repairs", cursor=cursor, limit=limit, open=only))

    def repair(self, repair: str) -> dict[str, Any]:
        """Return a repair with its diagnosis, plan and steps."""
        answer: dict[str, Any] = self.send(calls.get("repairs", repair))
        return answer

    def functions(self, robot: str) -> list[dict[str, Any]]:
        """Return by which variants the robot's functions work, and why."""
        answer: dict[str, Any] = self.send(calls.get("robots", robot, "functions"))
        return list(answer["functions"])

    def changes(
        self, robot: str, cursor: str | None = None, limit: int | None = None
    ) -> Page[dict[str, Any]]:
        """Return the changes of the robot's configuration, newest first."""
        return self.send(calls.page("robots", robot, "changes", cursor=cursor, limit=limit))

    def approve(self, repair: str, reason: str = "") -> dict[str, Any]:
        """Say yes to a repair, or a change of configuration (`c-…`), that waits for it."""
        answer: dict[str, Any] = self.send(
            calls.post(calls.kept(repair), repair, json={"decision": "approve", "reason": reason})
        )
        return answer

    def cancel(self, repair: str, reason: str = "") -> dict[str, Any]:
        """End a repair, or a change of configuration, before its next action."""
        answer: dict[str, Any] = self.send(
            calls.post(calls.kept(repair), repair, json={"decision": "cancel", "reason": reason})
        )
        return answer

    def start_drill(
        self,
        robot: str,
        fault: str,
        component: str | None = None,
        *,
        topic: str | None = None,
        bound_s: float = 60.0,
        detect_s: float = 15.0,
        reason: str = "",
    ) -> dict[str, Any]:
        """Plant a fault, which the service watches and undoes; `topic`: one that the component publishes."""
        value = {"fault": fault, "component": component, "topic": topic, "reason": reason}
        answer: dict[str, Any] = self.send(
            calls.post("robots", robot, "drills", json={**value, "bound_s": bound_s, "detect_s": detect_s})
        )
        return answer

    def drills(self, robot: str, cursor: str | None = None, limit: int | None = None) -> Page[dict[str, Any]]:
        """Return the robot's drills, newest first."""
        return self.send(calls.page("robots", robot, "drills", cursor=cursor, limit=limit))

    def drill(self, drill: str) -> dict[str, Any]:
        """Return a drill: what is planted, how it is undone, and what was seen."""
        answer: dict[str, Any] = self.send(calls.get("drills", drill))
        return answer

    def decide_drill(self, drill: str, decision: str, reason: str = "") -> dict[str, Any]:
        """Say `cancel`, `done` (of what it waits for) or `abandon` to an open drill."""
        value = {"decision": decision, "reason": reason}
        answer: dict[str, Any] = self.send(calls.post("drills", drill, json=value))
        return answer

    def quarantine(self, robot: str) -> dict[str, str]:
        """Return the components that are not tried again, each with the reason."""
        answer: dict[str, str] = self.send(calls.get("robots", robot, "quarantine"))
        return answer

    def release(self, robot: str, component: str, reason: str = "") -> None:
        """Let a quarantined component be tried again."""
        self.send(calls.release(robot, component, reason))

    def stopped(self) -> Stop:
        """Return whether the global stop is active."""
        answer: Stop = self.send(calls.get("stop"))
        return answer

    def stop(self, reason: str = "") -> Stop:
        """The global stop: no robot acts until `resume`."""
        answer: Stop = self.send(calls.post("stop", json={"reason": reason}, repeatable=True))
        return answer

    def resume(self, reason: str = "") -> Stop:
        """Lift the global stop."""
        answer: Stop = self.send(calls.resume(reason))
        return answer

    # --- moments of faults --------------------------------------------------------------------------

    def moments(
        self, robot: str, cursor: str | None = None, limit: int | None = None
    ) -> Page[dict[str, Any]]:
        """Return what the robot's agents kept of moments in which something turned bad, newest first."""
        return self.send(calls.page("robots", robot, "moments", cursor=cursor, limit=limit))

    def moment(self, moment: str) -> dict[str, Any]:
        """Return a moment with its freeze frame: last messages, values, log lines, processes."""
        answer: dict[str, Any] = self.send(calls.get("moments", moment))
        return answer

    def moment_recording(self, moment: str, into: IO[bytes]) -> None:
        """Write the recording of a moment (.mcap), piece by piece."""
        self.download(calls.get("moments", f"{moment}.mcap"), into)

    def keep_moment(self, robot: str, moment: Mapping[str, Any]) -> dict[str, Any]:
        """Hand in a moment; return its id, and how much of its recording is there: `have`."""
        answer: dict[str, Any] = self.send(calls.keep_moment(robot, moment))
        return answer

    def keep_recording(self, robot: str, moment: str, *, at: int, size: int, data: bytes) -> int:
        """Hand in a piece of a recording of `size` bytes; return where the next one is to begin."""
        answer = self.send(calls.keep_recording(robot, moment, at, size, data))
        return int(answer["have"])

    # --- batches of logs ----------------------------------------------------------------------------

    def start_batch(self, logs: Iterable[str], **fields: str | float | None) -> dict[str, Any]:
        """Have logs diagnosed that are below the service's `batch_folder`: files, folders, patterns.

        Args:
            logs: relative to that folder. fields: `model` or `source`, `observers`, … (docs/http.md).
        """
        answer: dict[str, Any] = self.send(calls.start_batch(logs, fields))
        return answer

    def upload_batch(
        self, logs: Sequence[tuple[str, IO[bytes]]], **fields: str | float | None
    ) -> dict[str, Any]:
        """Hand in logs and have them diagnosed; `fields` as for `start_batch`.

        Args:
            logs: name and open file of each; they are read as they are sent.
        """
        answer: dict[str, Any] = self.send(calls.upload_batch(logs, fields))
        return answer

    def batches(self, cursor: str | None = None, limit: int | None = None) -> Page[dict[str, Any]]:
        """Return batches, newest first."""
        return self.send(calls.page("batches", cursor=cursor, limit=limit))

    def batch(self, batch: str) -> dict[str, Any]:
        """Return a batch: how far it is, and what became of its logs."""
        answer: dict[str, Any] = self.send(calls.get("batches", batch))
        return answer

    def batch_result(self, batch: str, into: IO[bytes], format: str = "ndjson") -> None:
        """Write the results of a batch that has ended, piece by piece: ndjson, logs, parquet or report."""
        self.download(calls.get("batches", batch, "result", format=format), into)

    def cancel_batch(self, batch: str, reason: str = "") -> dict[str, Any]:
        """End a batch; one that has ended is a StateConflict."""
        answer: dict[str, Any] = self.send(calls.cancel_batch(batch, reason))
        return answer

    # --- the board, and the agent's side of actions ------------------------------------------------

    def board(self, robot: str) -> Board:
        """Return the link's state and the channels."""
        answer: Board = self.send(calls.get("robots", robot, "board"))
        return answer

    def switch_channel(self, robot: str, channel: int, on: bool, reason: str = "") -> None:
        """Switch a power channel; a protected one is refused."""
        self.send(calls.put_channel(robot, channel, on, reason))

    def next_action(
        self, robot: str, agent: str, *, host: str | None = None, wait_s: float = 20.0
    ) -> Action | None:
        """Wait for an action for this agent; None if there was none in time."""
        return self.send(calls.next_action(robot, agent, host, wait_s))

    def give_feedback(self, action_id: str, number: int, message: str = "") -> None:
        """Tell how an action is getting on."""
        self.send(calls.feedback(action_id, number, message))

    def give_result(self, action_id: str, result: ActionResult) -> FirstResult:
        """Tell how an action ended; return the result that counts, the first."""
        return self.send(calls.result(action_id, result))

    # --- what happened -----------------------------------------------------------------------------

    def history(
        self,
        robot: str,
        kind: HistoryKind = "observations",
        *,
        cursor: str | None = None,
        limit: int | None = None,
    ) -> Page[dict[str, Any]]:
        """Return accepted batches, diagnoses or repairs over time, newest first."""
        return self.send(calls.page("robots", robot, "history", kind=kind, cursor=cursor, limit=limit))

    def audit(
        self, robot: str | None = None, *, cursor: str | None = None, limit: int | None = None
    ) -> Page[dict[str, Any]]:
        """Return who did what, and why, newest first."""
        return self.send(calls.page("audit", robot=robot, cursor=cursor, limit=limit))
