"""What FastAPI does not write into the OpenAPI document by itself."""

from __future__ import annotations

import re
from typing import Any

from robomend.api import lists
from robomend.api.documented import PROBLEM
from robomend.api.ingestion import COMPONENTS
from robomend.api.problems import MEDIA_TYPE
from robomend.api.schemas.base import ProblemBody
from robomend.api.sign_in import PLAIN, SECURE
from robomend.security import API, EVERYONE, RULES

DESCRIPTION = """Finds out why a robot misbehaves, repairs it, and looks whether it worked.

Observations come in, minimal diagnoses come out; repairs are planned, approved and carried out. Lists are
`{"items": [...], "next": ...}`, or NDJSON for who asks; errors are problem details (RFC 9457) with a stable
`code`; what was acknowledged is on disk."""

TAGS = [
    {"name": "models", "description": "System descriptions, versioned; a robot follows its model"},
    {"name": "robots", "description": "What is configured of each robot"},
    {"name": "observations", "description": "What was observed comes in; OBS can be read"},
    {"name": "diagnosis", "description": "Why it misbehaves, and what to look at next"},
    {"name": "repair", "description": "Plans and repairs, and a person's yes or no"},
    {"name": "sovd", "description": "A robot's diagnoses and repairs for tools that read SOVD"},
    {"name": "drill", "description": "Faults that are planted on purpose, watched, and undone"},
    {"name": "batches", "description": "Recorded logs, diagnosed in processes of their own"},
    {"name": "board", "description": "The power board's channels"},
    {"name": "agent", "description": "The robot's side of repair: it pulls actions and reports"},
    {"name": "control", "description": "The global stop, and quarantine"},
    {"name": "events", "description": "Server-sent events with replay"},
    {"name": "history", "description": "What was, and who did what and why"},
    {"name": "session", "description": "A browser's sign-in, for pages: bearer keys need none"},
    {"name": "one-shots", "description": "Stateless diagnoses and plans, what-if included"},
    {"name": "operation", "description": "Health, readiness, metrics, versions"},
]


def complete(document: dict[str, Any]) -> dict[str, Any]:
    """Name operations, add the schemes of key and cookie, give problems their media type."""
    components = document.setdefault("components", {})
    components["schemas"]["ProblemBody"] = ProblemBody.model_json_schema()
    components["schemas"] |= COMPONENTS
    components["securitySchemes"] = {
        "key": {
            "type": "http",
            "scheme": "bearer",
            "description": "from `robomend keys create`; none is needed on loopback while no key exists",
        },
        "cookie": {
            "type": "apiKey",
            "in": "cookie",
            "name": PLAIN,
            "description": f"of a browser, from POST {API}/session; `{SECURE}` under TLS",
        },
    }
    for path, operations in document["paths"].items():
        for method, operation in operations.items():
            # The function's name alone: generated clients call their methods so.
            place = re.sub(r"\W", "_", path)
            operation["operationId"] = operation["operationId"].removesuffix(f"{place}_{method}")
            if RULES.get((method.upper(), path)) is not EVERYONE:
                operation["security"] = [{"key": []}, {"cookie": []}, {}]
            answers = operation.get("responses", {})
            if method == "get" and "application/json" in answers.get("200", {}).get("content", {}):
                lists.describe(operation)
                if path.startswith(API):  # robomend.api.edge
                    answers["200"].setdefault("headers", {})["ETag"] = _ETAG
                    answers["304"] = {
                        "description": "If-None-Match names this version: the client has it",
                        "headers": {"ETag": _ETAG},
                    }
            for status, response in answers.items():
                if status[0] in "45":
                    _as_problem(response)
    return document


_ETAG = {
    "description": "the name of this version, for If-None-Match",
    "schema": {"type": "string"},
    "example": '"4f1d6a"',
}


def _as_problem(response: dict[str, Any]) -> None:
    """An error is a problem whatever the framework assumes; /readyz alone answers 503 with what is amiss."""
    told = [each for each in response.get("content", {}).values() if "schema" in each]
    if told and "Readiness" in str(told[0]["schema"]):
        response["content"] = {"application/json": told[0], MEDIA_TYPE: PROBLEM}
    elif told:
        response["content"] = {MEDIA_TYPE: told[0]}
