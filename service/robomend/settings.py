"""The service's settings: flags over environment (ROBOMEND_*) over a YAML file over the defaults below.

Every limit of the service is here, with its unit in its name. `robomend config` prints each value with
where it came from. A setting that nobody knows is refused, so that a misspelt one is not silently without
effect. To add a setting: a field here, with its bounds and what it means: docs/reference.py lists it.
"""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal, get_args

from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    SecretStr,
    ValidationError,
    field_validator,
    model_validator,
)

from robomend import programs
from robomend.errors import InputError
from robomend_client.near import did_you_mean

ENVIRONMENT_PREFIX = "ROBOMEND_"

LISTS = frozenset({"allowed_hosts", "webhook_hosts"})
"""In the environment, with commas."""


_ADDRESS = re.compile(r"[^\s@<>,;\"]{1,64}@[^\s@<>,;\"]{1,253}")


class SettingsError(InputError):
    """A setting with an unknown name or a value out of range; says where it came from."""

    code = "bad-setting"


def data_folder() -> Path:
    """Return where data lives unless told: XDG_DATA_HOME/robomend."""
    root = os.environ.get("XDG_DATA_HOME") or Path.home() / ".local" / "share"
    return Path(root) / "robomend"


About = Literal["approval", "escalated", "change", "unknown", "stop"]


class RecipientSettings(BaseModel):
    """Somebody who is told when a person is needed, by a signed call or by mail."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    name: str = Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._\-]{0,63}$")
    url: SecretStr | None = None  # such addresses often hold a secret
    secret: SecretStr | None = Field(None, min_length=1)
    mail: tuple[str, ...] = Field((), max_length=20)
    about: tuple[About, ...] = get_args(About)
    robots: tuple[str, ...] = ("*",)  # patterns of ids

    @field_validator("mail")
    @classmethod
    def _addresses(cls, value: tuple[str, ...]) -> tuple[str, ...]:
        for address in value:
            if not _ADDRESS.fullmatch(address):
                raise ValueError(f"{address!r} is no mail address")
        return value


GONE = {
    "workers": "one process serves one port; for several, have the init system start instances on one "
    "PostgreSQL (robomend@.service, docs/deploy/README.md)"
}
"""Settings that there were, and what takes their place."""


class Settings(BaseModel):
    """Everything that `create_app` and `robomend serve` may be told."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    host: str = Field("127.0.0.1", description="address to listen on; any but loopback needs keys")
    port: int = Field(8600, ge=0, le=65535, description="0: a free one is chosen and announced")
    data: Path = Field(default_factory=data_folder, description="folder of the SQLite database")
    database: SecretStr | None = Field(None, description="URL of a database, instead of SQLite in `data`")
    allowed_hosts: tuple[str, ...] = Field(
        (), description="further names that a Host header may carry while there are no keys"
    )
    tls_certificate: Path | None = Field(None, description="PEM file; with tls_key, serves HTTPS")
    tls_key: Path | None = Field(None, description="PEM file of the private key")

    programs: dict[str, tuple[str, ...]] = Field(
        default_factory=dict,
        description="name -> argument list: what a robot's `process` executors may run on this computer",
    )
    webhook_hosts: tuple[str, ...] = Field(
        (),
        description="hosts (`name` or `name:port`) that webhooks may call at private addresses, too",
    )

    public_url: str | None = Field(
        None,
        pattern=r"^https?://[^\s/?#@]+(/[^\s?#]*)?$",
        description="where people reach this service: links in notifications begin so",
    )
    notify: tuple[RecipientSettings, ...] = Field(
        (), max_length=100, description="who is told that a person is needed; see notifications.md"
    )
    mail_server: str | None = Field(None, pattern=r"^\S+:\d{1,5}$", description="`host:port` for mail")
    mail_tls: Literal["starttls", "tls", "none"] = Field(
        "starttls", description="how the mail server is spoken to; `none` for one on this computer"
    )
    mail_from: str | None = Field(None, description="the sender's address")
    mail_user: str | None = Field(None, description="with mail_password, where the mail server wants them")
    mail_password: SecretStr | None = Field(None, description="is shown nowhere")

    max_head_bytes: int = Field(64 << 10, ge=1 << 10, description="of a request's line and headers; a 431")
    head_timeout_s: float = Field(30.0, gt=0, description="from a connection to its first whole head; a 408")
    max_body_bytes: int = Field(1 << 20, ge=1 << 10, description="of a JSON body; more is a 413")
    max_model_bytes: int = Field(4 << 20, ge=1 << 10, description="of a model's source; more is a 413")
    max_stream_bytes: int = Field(1 << 30, ge=1 << 10, description="of an NDJSON body; more is a 413")
    max_line_bytes: int = Field(64 << 10, ge=1 << 10, description="of one NDJSON line")
    max_nesting: int = Field(32, ge=4, le=200, description="of JSON arrays and objects")
    max_components: int = Field(100_000, ge=1, description="of a model")
    max_clauses: int = Field(1_000_000, ge=1, description="of a compiled model")
    max_model_steps: int = Field(
        250_000, ge=1, description="to compile a model's rules: ground literals and instances; more are a 422"
    )
    max_assertion_steps: int = Field(
        20_000, ge=1, description="to compile all assertions of a robot, or of a question; more are a 422"
    )
    max_robots: int = Field(
        50_000,
        ge=1,
        description="idle robots kept in memory; others are read again when asked for",
    )
    max_observed: int = Field(50_000, ge=1, description="literals in one robot's OBS")
    body_timeout_s: float = Field(30.0, gt=0, description="longest pause within a body before a 408")
    send_timeout_s: float = Field(60.0, gt=0, description="longest stall of a client that reads a stream")

    solver_timeout_s: float = Field(5.0, gt=0, description="of a diagnosis unless the request says")
    max_solver_timeout_s: float = Field(60.0, gt=0, description="longest that a request may ask for")
    inline_components: int = Field(
        120, ge=0, description="models up to this size are diagnosed on the event loop; larger in workers"
    )
    inline_budget_s: float = Field(
        0.005, gt=0, description="a diagnosis on the event loop that takes longer moves to a worker"
    )
    solver_workers: int = Field(1, ge=1, le=64, description="processes for slow diagnoses and one-shots")
    reader_workers: int = Field(
        2, ge=1, le=64, description="processes that read models and long sentences; one-shots leave one free"
    )
    reading_timeout_s: float = Field(30.0, gt=0, description="of reading a model; then its process is ended")
    planner_workers: int = Field(1, ge=1, le=64, description="processes for planning")
    one_shots: int = Field(8, ge=1, description="one-shots that may wait for a worker; more are a 503")

    batch_folder: Path | None = Field(
        None, description="logs below it may be named by who asks for a batch; unset: uploads only"
    )
    benchmark_folder: Path | None = Field(
        None, description="reports of `robomend-bench --out`, which the page shows; unset: none"
    )
    batches_at_once: int = Field(1, ge=1, le=64, description="batches that run; each is processes of its own")
    batch_workers: int = Field(1, ge=1, le=256, description="processes of one batch")
    batch_nice: int = Field(5, ge=0, le=19, description="how far its processes give way to the service")
    batches_waiting: int = Field(20, ge=1, le=1000, description="batches that wait or run; more are a 503")
    batches_kept: int = Field(50, ge=1, le=10_000, description="batches that ended, with their results")
    batches_days: float = Field(30.0, gt=0, description="a batch that ended is kept this long")
    batch_hours: float = Field(12.0, gt=0, le=8760, description="a batch may run this long; then it is ended")
    max_batch_bytes: int = Field(
        4 << 30, ge=1 << 10, description="of an upload (more is a 413), and of each file of results"
    )
    max_batch_logs: int = Field(1000, ge=1, le=10_000, description="log files of a batch; more are a 422")

    max_streams: int = Field(1000, ge=1, description="open event streams; more are a 503")
    max_waiters: int = Field(2000, ge=1, description="requests in a long poll; more are a 503")
    requests_per_s: float = Field(5000.0, gt=0, description="per key, sustained; more is a 429")
    sign_in_hours: float = Field(12.0, gt=0, le=8760, description="a browser is signed in this long")
    sign_ins_per_minute: float = Field(30.0, gt=0, description="per client address; more are a 429")
    burst: int = Field(10_000, ge=1, description="requests that may come at once, per key")
    max_wait_s: float = Field(60.0, gt=0, description="longest long poll")
    ping_s: float = Field(
        15.0, gt=0, description="a comment on an idle event stream keeps proxies from closing it"
    )
    graceful_s: float = Field(5.0, gt=0, description="for requests to end at shutdown")

    observations_days: float = Field(
        30.0, gt=0, description="accepted batches are kept this long, and as long as events"
    )
    diagnoses_days: float = Field(
        30.0, gt=0, description="diagnoses are kept this long, and as long as events"
    )
    events_days: float = Field(7.0, gt=0, description="events are kept this long: how far streams replay")
    repairs_days: float = Field(365.0, gt=0, description="repairs that ended are kept this long")
    moments_days: float = Field(30.0, gt=0, description="moments of faults are kept this long")
    moments_mb: float = Field(
        1024.0, gt=0, description="moments of all robots, recordings and all; the oldest go for newer ones"
    )
    moments_kept: int = Field(100, ge=1, le=100_000, description="moments of one robot; the oldest go")
    max_recording_mb: float = Field(64.0, gt=0, description="of one moment; more is a 413")
    log_level: Literal["debug", "info", "warning", "error"] = "info"
    log_format: Literal["json", "text"] = "json"

    @field_validator("programs")
    @classmethod
    def _templates(cls, value: dict[str, tuple[str, ...]]) -> dict[str, tuple[str, ...]]:
        for name, template in value.items():
            try:
                programs.check_template(template)
            except programs.Unfit as error:
                raise ValueError(f"program {name!r}: {error}") from error
        return value

    @field_validator("mail_from")
    @classmethod
    def _sender(cls, value: str | None) -> str | None:
        if value is not None and not _ADDRESS.fullmatch(value):
            raise ValueError(f"{value!r} is no mail address")
        return value

    @model_validator(mode="after")
    def _can_be_told(self) -> Settings:
        names = [one.name for one in self.notify]
        if len(set(names)) < len(names):
            raise ValueError("notify: two recipients have one name")
        for one in self.notify:
            if (one.url is None) == (not one.mail):
                raise ValueError(f"notify: {one.name} needs a url with its secret, or mail, and not both")
            if one.mail and (self.mail_server is None or self.mail_from is None):
                raise ValueError(f"notify: mail to {one.name} needs the settings mail_server and mail_from")
            if one.url is not None:
                _check_webhook(one, self.webhook_hosts)
        if self.mail_user is not None and self.mail_tls == "none":
            raise ValueError("mail_tls: a password is not sent without TLS")
        return self

    @property
    def database_url(self) -> str:
        """The URL of the database, password included: as set, or SQLite in the data folder."""
        if self.database is not None:
            return self.database.get_secret_value()
        return f"sqlite:///{self.data.expanduser().resolve() / 'robomend.db'}"


def _check_webhook(one: RecipientSettings, hosts: tuple[str, ...]) -> None:
    from robomend.webhooks import receiver  # brings an HTTP client, which few commands need

    secret = "" if one.secret is None else one.secret.get_secret_value()
    url = "" if one.url is None else one.url.get_secret_value()
    try:
        receiver({"url": url, "secret": secret}, hosts)
    except InputError as error:
        raise ValueError(f"notify: {one.name}: {error}") from error


def load(
    flags: Mapping[str, Any], environment: Mapping[str, str], file: Path | None
) -> tuple[Settings, dict[str, str]]:
    """Return the settings and, for each, the source of its value.

    Args:
        flags: what the command line said; None means not said.
        environment: os.environ or the like.
        file: a YAML mapping of setting names to values.

    Raises:
        SettingsError: an unknown name, or a value that does not fit, with its source.
    """
    values: dict[str, Any] = {}
    sources = dict.fromkeys(Settings.model_fields, "default")
    for source, given in (
        (str(file), _from_file(file) if file else {}),
        *(
            (f"environment {ENVIRONMENT_PREFIX}{name.upper()}", {name: value})
            for name, value in _from_environment(environment).items()
        ),
        ("flag", {name: value for name, value in flags.items() if value is not None}),
    ):
        for name, value in given.items():
            if name in GONE:
                raise SettingsError(f"{source}: {name}: {GONE[name]}")
            if name not in Settings.model_fields:
                if {"robomend", "hardware"} & given.keys():
                    raise SettingsError(
                        f"{source}: this is a model, and settings of the service are wanted, as "
                        "`robomend config` lists them; `robomend robot put ID robot.yaml --model "
                        f"{source}` hands in a model"
                    )
                near = did_you_mean(name, Settings.model_fields)
                raise SettingsError(
                    f"{source}: there is no setting {name!r}{near or '; see `robomend config`'}"
                )
            values[name] = value
            sources[name] = source
    try:
        return Settings.model_validate(values), sources
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        name = str(first["loc"][0]) if first["loc"] else "settings"
        place = ".".join(map(str, first["loc"])) or name
        raise SettingsError(f"{place} (from {sources.get(name, 'settings')}): {first['msg']}") from error


def shown(settings: Settings) -> dict[str, Any]:
    """Return the settings as JSON values, secrets masked."""
    return settings.model_dump(mode="json")


def _from_environment(environment: Mapping[str, str]) -> dict[str, Any]:
    """Return the settings that the environment names; other ROBOMEND_ variables belong to other tools."""
    found: dict[str, Any] = {}
    for name in (*Settings.model_fields, *GONE):
        text = environment.get(f"{ENVIRONMENT_PREFIX}{name.upper()}")
        if text is not None:
            found[name] = tuple(filter(None, text.split(","))) if name in LISTS else text
    return found


def _from_file(file: Path) -> dict[str, Any]:
    import yaml

    try:
        text = file.read_text(encoding="utf-8")
        values = yaml.safe_load(text)
    except OSError as error:
        raise SettingsError(f"{file}: {error.strerror}") from error
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise SettingsError(f"{file}: not YAML: {error}") from error
    if values is None:
        return {}
    if not isinstance(values, dict) or not all(isinstance(name, str) for name in values):
        raise SettingsError(f"{file}: expected a mapping of setting names to values")
    return values
