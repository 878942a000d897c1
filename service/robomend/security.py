"""Who may do what: bearer keys, roles, and the one table that every route is checked against.

A key reads `rm_` and 43 characters, 256 random bits. Stored is its SHA-256. A slow password hash would add
nothing: there is no dictionary to try for 256 random bits, and every request would pay for it.

    viewer     reads everything but the audit log
    robot      one robot's own resources: its observations, actions and events, and nothing else
    operator   viewer, and approves, cancels, switches, stops, changes robots and models
    admin      operator, the audit log, and whatever else there is

A browser shows its key once, at sign-in, and then a cookie, for the same rights: see robomend.api.gate.

RULES is the policy. A route that is not in it is refused to everyone, so a new route cannot be forgotten;
tests/api/test_roles.py walks every route × role.

To add a route: 1. its function in a module of robomend/api/routers/ (a new module is included in
robomend/api/app.py), its body and answer as models of robomend/api/schemas/; 2. its line in RULES; 3. its
docstring, whose first paragraph is its row in the reference (docs/reference.py); 4. where robots and programs
are to call it, a method of robomend_client/rest/asynchronous.py (the one for threads is made of it), and
its answer in robomend_client/rest/types.py.
"""

from __future__ import annotations

import hashlib
import ipaddress
import re
import secrets
from dataclasses import dataclass
from enum import StrEnum

KEY = re.compile(r"rm_[A-Za-z0-9_-]{43}\Z")
"""Anything else in an Authorization header is refused before the store is asked."""


class Role(StrEnum):
    """What a key is for; each is a set of rights, not a rank."""

    VIEWER = "viewer"
    ROBOT = "robot"
    OPERATOR = "operator"
    ADMIN = "admin"


@dataclass(frozen=True, slots=True)
class Principal:
    """Whoever makes a request: a key, or the person at this computer when there is no key at all."""

    name: str  # of the key, never its text; goes to the audit log
    role: Role
    robot: str | None = None  # of role robot: its own id
    key: str | None = None  # the key's id
    until_ns: int | None = None  # of a browser that is signed in: when that ends

    def __post_init__(self) -> None:
        if (self.role is Role.ROBOT) != (self.robot is not None):
            raise ValueError("a key of role robot names its robot, and no other key does")


LOCAL = Principal("local", Role.ADMIN)
"""Loopback, and no key was ever created: whoever can reach the port owns this computer's account already."""


def new_key() -> str:
    """Return the text of a fresh key. It is shown once and stored nowhere."""
    return "rm_" + secrets.token_urlsafe(32)


def digest(key: str) -> str:
    """Return what is stored of a key."""
    return hashlib.sha256(key.encode()).hexdigest()


READ = frozenset({Role.VIEWER, Role.OPERATOR, Role.ADMIN})
ACT = frozenset({Role.OPERATOR, Role.ADMIN})
OWN = frozenset({Role.ROBOT})  # and only where the path's robot (or the action's) is the key's own
EVERYONE: frozenset[Role] | None = None  # no key needed; the sign-in brings its own

API = "/api/v1"

RULES: dict[tuple[str, str], frozenset[Role] | None] = {
    ("GET", API): READ | OWN,
    ("GET", f"{API}/models"): READ,
    ("GET", f"{API}/models/{{name}}"): READ,
    ("PUT", f"{API}/models/{{name}}"): ACT,
    ("DELETE", f"{API}/models/{{name}}"): ACT,
    ("GET", f"{API}/models/{{name}}/versions"): READ,
    ("POST", f"{API}/models/{{name}}/isolability"): READ,
    ("GET", f"{API}/status"): READ,
    ("GET", f"{API}/robots"): READ,
    ("GET", f"{API}/robots/{{robot}}"): READ | OWN,
    ("GET", f"{API}/robots/{{robot}}/model"): READ | OWN,
    ("PUT", f"{API}/robots/{{robot}}"): ACT,
    ("DELETE", f"{API}/robots/{{robot}}"): ACT,
    ("POST", f"{API}/robots/{{robot}}/observations"): ACT | OWN,
    ("GET", f"{API}/robots/{{robot}}/observations"): READ | OWN,
    ("DELETE", f"{API}/robots/{{robot}}/assertions/{{assertion}}"): ACT | OWN,
    ("GET", f"{API}/robots/{{robot}}/diagnosis"): READ | OWN,
    ("GET", f"{API}/robots/{{robot}}/probes"): READ | OWN,
    ("POST", f"{API}/robots/{{robot}}/plans"): READ,
    ("POST", f"{API}/robots/{{robot}}/repairs"): ACT,
    ("GET", f"{API}/robots/{{robot}}/repairs"): READ | OWN,
    ("GET", f"{API}/robots/{{robot}}/functions"): READ | OWN,
    ("GET", f"{API}/robots/{{robot}}/changes"): READ | OWN,
    ("GET", f"{API}/changes/{{change}}"): READ,
    ("POST", f"{API}/changes/{{change}}"): ACT,
    ("GET", f"{API}/repairs"): READ,
    ("GET", f"{API}/repairs/{{repair}}"): READ,
    ("POST", f"{API}/repairs/{{repair}}"): ACT,
    ("POST", f"{API}/robots/{{robot}}/drills"): ACT,
    ("GET", f"{API}/robots/{{robot}}/drills"): READ | OWN,
    ("POST", f"{API}/robots/{{robot}}/moments"): OWN | frozenset({Role.ADMIN}),
    ("GET", f"{API}/robots/{{robot}}/moments"): READ | OWN,
    ("PUT", f"{API}/robots/{{robot}}/moments/{{moment}}/recording"): OWN | frozenset({Role.ADMIN}),
    ("GET", f"{API}/moments/{{moment}}.mcap"): READ,
    ("GET", f"{API}/moments/{{moment}}.json"): READ,
    ("GET", f"{API}/moments/{{moment}}"): READ,
    ("GET", f"{API}/robots/{{robot}}/sovd/apps"): READ,
    ("GET", f"{API}/robots/{{robot}}/sovd/components"): READ,
    ("GET", f"{API}/robots/{{robot}}/sovd/components/{{component}}/faults"): READ,
    ("GET", f"{API}/robots/{{robot}}/sovd/faults"): READ,
    ("GET", f"{API}/robots/{{robot}}/sovd/operations"): READ,
    ("GET", f"{API}/robots/{{robot}}/sovd/operations/repair/executions"): READ,
    ("POST", f"{API}/robots/{{robot}}/sovd/operations/repair/executions"): ACT,
    ("GET", f"{API}/robots/{{robot}}/sovd/operations/repair/executions/{{repair}}"): READ,
    ("GET", f"{API}/drills/{{drill}}"): READ,
    ("POST", f"{API}/drills/{{drill}}"): ACT,
    ("POST", f"{API}/batches"): ACT,
    ("GET", f"{API}/batches"): READ,
    ("GET", f"{API}/batches/{{batch}}"): READ,
    ("GET", f"{API}/batches/{{batch}}/result"): READ,
    ("DELETE", f"{API}/batches/{{batch}}"): ACT,
    ("GET", f"{API}/robots/{{robot}}/board"): READ | OWN,
    ("PUT", f"{API}/robots/{{robot}}/board/channels/{{channel}}"): ACT,
    ("GET", f"{API}/robots/{{robot}}/actions/next"): OWN | frozenset({Role.ADMIN}),
    ("POST", f"{API}/robots/{{robot}}/actions/next"): OWN | frozenset({Role.ADMIN}),
    ("POST", f"{API}/actions/{{action}}/feedback"): OWN | frozenset({Role.ADMIN}),
    ("POST", f"{API}/actions/{{action}}/result"): OWN | frozenset({Role.ADMIN}),
    ("GET", f"{API}/robots/{{robot}}/history"): READ,
    ("GET", f"{API}/audit"): frozenset({Role.ADMIN}),
    ("GET", f"{API}/notifications"): frozenset({Role.ADMIN}),
    ("GET", f"{API}/notifications/recipients"): frozenset({Role.ADMIN}),
    ("POST", f"{API}/notifications/recipients/{{recipient}}/test"): frozenset({Role.ADMIN}),
    ("GET", f"{API}/stop"): READ | OWN,
    ("POST", f"{API}/stop"): ACT,
    ("DELETE", f"{API}/stop"): ACT,
    ("GET", f"{API}/robots/{{robot}}/quarantine"): READ,
    ("POST", f"{API}/robots/{{robot}}/quarantine/{{component}}/release"): ACT,
    ("GET", f"{API}/events"): READ,
    ("GET", f"{API}/robots/{{robot}}/events"): READ | OWN,
    ("POST", f"{API}/diagnoses"): READ,
    ("POST", f"{API}/plans"): READ,
    ("POST", f"{API}/session"): EVERYONE,
    ("GET", f"{API}/session"): READ | OWN,
    ("DELETE", f"{API}/session"): READ | OWN,
    ("GET", "/healthz"): EVERYONE,
    ("GET", "/readyz"): EVERYONE,
    ("GET", "/metrics"): READ,
    ("GET", "/version-info"): EVERYONE,
    ("GET", "/docs"): EVERYONE,
    ("GET", "/docs/{file}"): EVERYONE,
    ("GET", "/openapi.json"): EVERYONE,
    ("GET", "/"): READ,
    ("GET", "/ui/robots/{robot}"): READ,
    ("GET", "/ui/robots/{robot}/drills"): READ,
    ("POST", "/ui/robots/{robot}/drills"): ACT,
    ("POST", "/ui/drills/{drill}"): ACT,
    ("POST", "/ui/robots/{robot}/observations"): ACT,
    ("POST", "/ui/robots/{robot}/repairs"): ACT,
    ("POST", "/ui/robots/{robot}/release"): ACT,
    ("POST", "/ui/robots/{robot}/board/{channel}"): ACT,
    ("GET", "/ui/repairs/{repair}"): READ,
    ("POST", "/ui/repairs/{repair}"): ACT,
    ("GET", "/ui/moments/{moment}"): READ,
    ("GET", "/ui/repairs/{repair}/report"): READ,
    ("GET", "/ui/repairs"): READ,
    ("GET", "/ui/batches"): READ,
    ("POST", "/ui/batches"): ACT,
    ("GET", "/ui/batches/{batch}"): READ,
    ("POST", "/ui/batches/{batch}"): ACT,
    ("GET", "/ui/benchmarks"): READ,
    ("GET", "/ui/benchmarks/{report}"): READ,
    ("GET", "/ui/benchmarks/plots/{plot}"): READ,
    ("GET", "/ui/models"): READ,
    ("POST", "/ui/models"): ACT,
    ("GET", "/ui/models/{name}"): READ,
    ("POST", "/ui/models/{name}/answers"): ACT,
    ("GET", "/ui/models/{name}/compare"): READ,
    ("GET", "/ui/models/{name}/isolability"): READ,
    ("GET", "/ui/what-if"): READ,
    ("GET", "/ui/audit"): frozenset({Role.ADMIN}),
    ("GET", "/ui/keys"): frozenset({Role.ADMIN}),
    ("POST", "/ui/keys"): frozenset({Role.ADMIN}),
    ("POST", "/ui/keys/{key}"): frozenset({Role.ADMIN}),
    ("GET", "/ui/notifications"): frozenset({Role.ADMIN}),
    ("POST", "/ui/notifications"): frozenset({Role.ADMIN}),
    ("POST", "/ui/stop"): ACT,
    ("GET", "/ui/sign-in"): EVERYONE,
    ("POST", "/ui/sign-in"): EVERYONE,
    ("POST", "/ui/sign-out"): READ | OWN,
    ("GET", "/ui/static/{version}/{file}"): EVERYONE,
}
"""(method, path template) -> the roles that may; EVERYONE needs no key."""


def loopback(host: str) -> bool:
    """Return whether listening on `host` is reachable from this computer only."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host.strip("[]")).is_loopback
    except ValueError:
        return False


def host_name(header: str) -> str:
    """Return the name in a Host header or an origin's authority, without the port, in lower case."""
    name = header.rsplit("@", 1)[-1].strip().lower()
    if name.startswith("["):
        return name[1:].split("]", 1)[0]
    return name.rsplit(":", 1)[0] if ":" in name else name
