"""From the core's values to the wire, one function per kind of thing.

JSON that may be long is written in a thread: to write it takes up to tens of milliseconds.
"""

from __future__ import annotations

import asyncio
import json
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

from starlette.responses import Response

from robomend.api.schemas.diagnosis import AskOptionsBody, ProbeOut, ProbesOut
from robomend.api.schemas.drill import DrillOut
from robomend.api.schemas.models import FiveKeyOut, ModelOut, VersionOut
from robomend.api.schemas.observations import AssertionOut, ObservedLiteral, ObsOut, ReadingOut, SourceWord
from robomend.api.schemas.repair import BoardOut, ChannelOut
from robomend.api.schemas.repair_record import FunctionOut, FunctionsOut, VariantOut
from robomend.api.schemas.robots import AgentOut, RobotBody, RobotLine, RobotOut
from robomend.diagnosis.probes import ProbeResult
from robomend.diagnosis.result import DiagnosisResult, Options
from robomend.entry import Entry
from robomend.model.five_key import FiveKey
from robomend.model.functions import spoken_of
from robomend.model.system import System
from robomend.model.vocabulary import ACTIVE
from robomend.oneshots.result_json import quoted_names, result_text
from robomend.repairs.foresight import contradicted
from robomend.repairs.headline import of_robot
from robomend.repairs.repair_json import repair_json
from robomend.robots.boards import WiredBoard
from robomend.robots.clock import CLOCK
from robomend.robots.configuration import covered
from robomend.robots.health import health_of
from robomend.robots.robot import Robot
from robomend.settings import Settings
from robomend.store import Store, View, diagnoses, drills, observations, repairs, robots
from robomend.store.records import (
    AuditEntry,
    Paging,
    StepRecord,
    StoredBatch,
    StoredDiagnosis,
    StoredDrill,
    StoredModel,
    StoredRepair,
    StoredRobot,
)
from robomend.timestamps import rfc3339, with_texts

_text = json.JSONEncoder(ensure_ascii=False, allow_nan=False, separators=(",", ":")).encode


def page_text(items: Iterable[Any], following: str | None) -> bytes:
    """Return a page of a list; call it where the items are read, in a thread of the store's."""
    return f'{{"items":[{",".join(map(_text, items))}],"next":{_text(following)}}}'.encode()


def response_of(text: bytes) -> Response:
    """Return the answer that has this text."""
    return Response(text, media_type="application/json")


async def result_response(result: DiagnosisResult) -> Response:
    """Return an engine's answer as it is; ResultOut only describes it."""
    text = await asyncio.to_thread(result_text, result, quoted_names(result.components))
    return response_of(text.encode())


async def value_response(make: Callable[..., Any], given: list[Any]) -> Response:
    """Return the value that `make` makes of what is given.

    `given` is empty afterwards: what is large and nobody else has is freed in the thread that wrote it.
    """

    def written() -> bytes:
        text = _text(make(*given)).encode()
        given.clear()
        return text

    return response_of(await asyncio.to_thread(written))


def model_out(model: StoredModel, system: System) -> ModelOut:
    """Return a model with what its loader had to say."""
    return ModelOut(
        name=model.name,
        version=model.version,
        number=model.number,
        format=model.format,
        source=model.source,
        components=list(system.cnf.components),
        warnings=list(system.warnings),
        created_ns=model.created_ns,
        by=model.by,
    )


def five_key_out(model: StoredModel, keys: FiveKey) -> FiveKeyOut:
    """Return a model in five keys."""
    return FiveKeyOut(
        model=model.name,
        version=model.version,
        ab=keys.ab,
        nab=keys.nab,
        neg_prefix=keys.neg_prefix,
        props=list(keys.props),
        rules=list(keys.rules),
    )


def version_out(model: StoredModel) -> VersionOut:
    """Return a model in a list."""
    return VersionOut(
        name=model.name,
        version=model.version,
        number=model.number,
        format=model.format,
        created_ns=model.created_ns,
        by=model.by,
    )


def robot_line(robot: StoredRobot) -> RobotLine:
    """Return a robot in a list."""
    return RobotLine(
        id=robot.id,
        model=str(robot.config["model"]),
        policy=str(robot.config.get("policy", "approve")),
        etag=robot.etag,
        updated_ns=robot.updated_ns,
    )


def robot_out(
    state: Robot,
    findings: Sequence[str],
    drill: Mapping[str, Any] | None = None,
    repair: Mapping[str, Any] | None = None,
) -> RobotOut:
    """Return a robot's configuration and how it is."""
    how, unknown = health_of(state)
    return RobotOut(
        id=state.id,
        config=RobotBody.model_validate(covered(state.stored.config)),
        etag=state.stored.etag,
        created_ns=state.stored.created_ns,
        updated_ns=state.stored.updated_ns,
        revision=state.revision,
        model_version=state.model.version,
        healthy=how.healthy,
        state=how.value,
        headline=of_robot(state, repair).text(time.time_ns()),
        unknown=[str(atom) for atom in unknown],
        findings=list(findings),
        agents=[
            AgentOut(
                agent=said.agent,
                host=said.host,
                can=None if said.can is None else sorted(said.can),
                observes=list(map(str, sorted(said.observes))),
                starved_ns=said.starved_ns,
            )
            for said in state.sight.declared.agents()
        ],
        drill=None if drill is None else DrillOut.model_validate(drill),
    )


def functions_out(state: Robot) -> FunctionsOut:
    """Return how the robot's functions stand."""
    return FunctionsOut(
        functions=[
            FunctionOut(
                function=name,
                active=one.active,
                goal=one.goal,
                works=one.works,
                criticality=one.function.criticality.value,
                held=one.held or one.unknown,
                variants=[
                    VariantOut(variant=variant, admissible=standing.admissible, why=standing.why)
                    for variant, standing in one.standings.items()
                ],
            )
            for name, one in state.function_states().items()
        ]
    )


def obs_out(state: Robot) -> ObsOut:
    """Return OBS now, in the order of the atoms."""
    now = CLOCK.now_ns()
    used = state.system.cnf.atom_variable.keys() | spoken_of(state.system.conditions)
    unconfirmed = frozenset(state.sight.not_confirmed())
    entries = sorted(state.obs.entries(), key=lambda entry: entry.literal.atom)
    return ObsOut(
        revision=state.revision,
        observations=[
            ObservedLiteral(
                literal=str(entry.literal),
                source=entry.source,
                time_ns=entry.time_ns,
                expires_ns=None if entry.contradicted else entry.expires_ns,
                since_ns=entry.since_ns,
                onset_ns=entry.onset_ns,
                confirmed=entry.atom not in unconfirmed,
                fresh=entry.fresh(now),
                used=entry.atom in used or entry.atom.predicate == ACTIVE,
                reading=_reading_out(entry),
                contradicted=entry.contradicted,
                by_source=[_word_out(word.entry) for word in entry.by_source],
            )
            for entry in entries
        ],
        assertions=[
            AssertionOut(
                name=record.name,
                sentence=record.sentence,
                source=record.source,
                time_ns=record.time_ns,
                expires_ns=record.expires_ns,
            )
            for _, record in sorted(state.assertion_records.items())
        ],
    )


def _reading_out(entry: Entry) -> ReadingOut | None:
    reading = entry.reading
    return None if reading is None else ReadingOut(**reading._asdict(), text=str(reading))


def _word_out(said: Entry) -> SourceWord:
    return SourceWord(
        literal=str(said.literal),
        source=said.source,
        time_ns=said.time_ns,
        expires_ns=said.expires_ns,
        since_ns=said.since_ns,
        onset_ns=said.onset_ns,
        reading=_reading_out(said),
    )


def diagnosis_response(state: Robot) -> Response:
    """Return the current diagnosis; its JSON is made already."""
    current = state.current
    body: dict[str, Any] = {
        "robot": state.id,
        "revision": 0 if current is None else current.revision,
        "model_version": None if current is None else current.model_version,
        "time_ns": None if current is None else current.time_ns,
        "time": None if current is None else rfc3339(current.time_ns),
        "result": None if current is None else current.result,
        "fault": None if current is None else current.fault,
        "expected_stopped": [] if current is None else current.expected_stopped,
        "findings": contradicted(state),
    }
    return Response(json.dumps(body), media_type="application/json", headers={"Cache-Control": "no-store"})


def probes_out(revision: int, found: ProbeResult) -> ProbesOut:
    """Return the probes with the diagnoses that they tell apart."""
    return ProbesOut(
        revision=revision,
        probes=[
            ProbeOut(
                atom=str(probe.atom),
                gain_bits=probe.gain_bits,
                cost_s=probe.cost_s,
                if_true=[list(found.diagnoses[index]) for index in probe.if_true],
                if_false=[list(found.diagnoses[index]) for index in probe.if_false],
            )
            for probe in found.probes
        ],
        entropy_bits=found.entropy_bits,
        complete=found.complete,
        reason=found.reason,
    )


def board_out(board: WiredBoard) -> BoardOut:
    """Return the link's state and each channel's reading."""
    snapshot = board.link.snapshot
    readings = snapshot.channels
    count = board.link.channels or 0
    return BoardOut(
        host=board.config.host,
        port=board.config.port,
        state=str(board.link.state),
        reason=board.link.reason,
        time_ns=snapshot.time_ns,
        channels=[
            ChannelOut(
                channel=channel,
                component=board.components.get(channel),
                on=None if readings is None else readings[channel].on,
                current_a=None if readings is None else readings[channel].current_a,
                voltage_v=None if readings is None else readings[channel].voltage_v,
                protected=channel in board.protected,
            )
            for channel in range(count)
        ],
    )


def audit_json(entry: AuditEntry) -> dict[str, Any]:
    """Return an entry of the audit log; AuditOut only describes it."""
    # Of the stop alone: elsewhere a name may be somebody's own, as of a program's options.
    with_times = with_texts if entry.action.startswith("stop.") else _as_it_is
    return {
        "id": entry.id,
        "time_ns": entry.time_ns,
        "time": rfc3339(entry.time_ns),
        "actor": entry.actor,
        "action": entry.action,
        "subject": entry.subject,
        "robot": entry.robot,
        "reason": entry.reason,
        "before": with_times(entry.before),
        "after": with_times(entry.after),
    }


def _as_it_is(value: Any) -> Any:
    return value


async def history_text(store: Store, robot: str, kind: str, paging: Paging) -> bytes:
    """Return a page of one kind of a robot's history, newest first; NotFound if there is no such robot.

    HistoryLine only describes it.
    """

    def look(view: View) -> bytes:
        robots.get(view, robot)
        if kind == "diagnosis":
            found = diagnoses.page(view, robot, paging)
            times = [item.time_ns for item in found.items]
            drilled = drills.between(view, robot, min(times), max(times)) if times else ()
            return page_text((_diagnosis_line(item, drilled) for item in found.items), found.next)
        if kind == "repair":
            begun = repairs.page(view, robot, paging)
            lines = (_repair_line(item, repairs.steps(view, item.id)) for item in begun.items)
            return page_text(lines, begun.next)
        batches = observations.history(view, robot, paging)
        return page_text(map(_batch_line, batches.items), batches.next)

    return await store.read(look)


def _diagnosis_line(item: StoredDiagnosis, drilled: Sequence[StoredDrill]) -> dict[str, Any]:
    at = item.time_ns
    during = [d.id for d in drilled if d.created_ns <= at and (d.open or at <= d.updated_ns)]
    data = {"revision": item.revision, "model_version": item.model_version, **item.result}
    data["drill"] = during[0] if during else None
    return _line("diagnosis", at, data)


def _repair_line(item: StoredRepair, steps: Sequence[StepRecord]) -> dict[str, Any]:
    return _line("repair", item.created_ns, with_texts(repair_json(item, steps)))


def _batch_line(item: StoredBatch) -> dict[str, Any]:
    data = {
        "revision": item.revision,
        "by": item.by,
        "observations": [
            with_texts(
                {
                    "literal": str(e.literal),
                    "source": e.source,
                    "time_ns": e.time_ns,
                    "reading": e.measured(),
                }
            )
            for e in item.entries
        ],
        "asserted": {assertion.name: assertion.sentence for assertion in item.asserted},
        "withdrawn": list(item.withdrawn),
    }
    return _line("observations", item.time_ns, data)


def _line(kind: str, time_ns: int, data: dict[str, Any]) -> dict[str, Any]:
    return {"kind": kind, "time_ns": time_ns, "time": rfc3339(time_ns), "data": data}


def engine_options(
    body: AskOptionsBody, settings: Settings, *, healthy: Sequence[str], abnormal: Sequence[str]
) -> Options:
    """Return how far the engine is to search, within the service's own limit of time."""
    timeout_s = body.timeout_s or settings.solver_timeout_s
    return Options(
        minimal=body.minimal,
        max_size=body.max_size,
        limit=body.limit,
        timeout_s=min(timeout_s, settings.max_solver_timeout_s),
        conflicts=body.conflicts,
        healthy=frozenset(healthy),
        abnormal=frozenset(abnormal),
    )
