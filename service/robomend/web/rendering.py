"""Templates to HTML. Everything is escaped, nothing is inline, every number has its unit.

Whatever a model, a robot or a person named is shown in a <bdi>, so that right-to-left text stays in its
place. Times are by the service's clock, in UTC: the page's script says in their titles how long ago that was.
"""

from __future__ import annotations

import hashlib
import json
import re
import time as clocks
from datetime import UTC, date, datetime
from functools import cache, lru_cache
from pathlib import Path
from typing import Any
from urllib.parse import urlencode

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from robomend.planning.plan import in_prose, step_title
from robomend.repairs.account import how_it_ended, not_chosen, since, waited
from robomend.repairs.headline import Told, clock, in_words, observed, question
from robomend.web.moment_plot import svg as moment_svg
from robomend.web.plan_graph import svg as plan_svg
from robomend.web.words import did, duration, layers, listed, repair_state, size, without
from robomend_client.counts import counted

HERE = Path(__file__).resolve().parent
STATIC = HERE / "static"

NAVIGATION = (
    ("/", "Robots", "all"),
    ("/ui/repairs", "Repairs", "all"),
    ("/ui/batches", "Batches", "all"),
    ("/ui/models", "Models", "all"),
    ("/ui/what-if", "What if", "all"),
    ("/ui/audit", "Audit", "admin"),
    ("/ui/keys", "Keys", "admin"),
    ("/ui/notifications", "Notifications", "admin"),
)
"""Address, name, and whether it is for all or for admins."""

ROWS = 100
"""Robots on a page unless asked for more."""

MOST_ROWS = 500
"""The others come with the next page."""

COMMENTS = re.compile(rb"^[ \t]*(?://[^\n]*\n|/\*(?:(?!\*/).)*\*/[ \t]*\n)", re.MULTILINE | re.DOTALL)
"""Those that have lines of their own: a tenth of what a first visit weighs."""

MEDIA_TYPES = {".css": "text/css", ".js": "text/javascript", ".svg": "image/svg+xml"}


def render(template: str, **values: Any) -> str:
    """Return a template with its values."""
    return _environment().get_template(template).render(values)


def fleet_row(line: object) -> Markup:
    """Return a line of the list of robots; most are the same from look to look, and for all who look."""
    return _fleet_row(line, datetime.now(UTC).date())


@lru_cache(maxsize=4096)
def _fleet_row(line: object, today: date) -> Markup:
    return Markup(render("fleet_row.html", line=line))


@cache
def static_files() -> dict[str, tuple[bytes, str]]:
    """Return the files that pages ask for, without their comments: name -> content and media type."""
    return {
        path.name: (COMMENTS.sub(b"", path.read_bytes()), MEDIA_TYPES[path.suffix])
        for path in sorted(STATIC.iterdir())
        if path.suffix in MEDIA_TYPES
    }


@cache
def static_version() -> str:
    """Return what changes with the content of any file: a part of their addresses, so that browsers may keep
    them, and that a script gets the others of its own version.
    """
    return hashlib.sha256(b"".join(content for content, _ in static_files().values())).hexdigest()[:12]


def static_address(name: str) -> str:
    """Return where a file is; KeyError if there is none."""
    assert static_files()[name]
    return f"/ui/static/{static_version()}/{name}"


@cache
def _environment() -> Environment:
    environment = Environment(
        loader=FileSystemLoader(HERE / "templates"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters.update(counted=counted)
    environment.filters.update(
        listed=listed, repair_state=repair_state, did=did, size=size, layers=layers, json=in_json
    )
    environment.filters.update(
        without=without, plan_graph=lambda plan, states: Markup(plan_svg(plan, states))
    )
    environment.filters.update(
        plot=lambda one: Markup(moment_svg(one.source, one.kind, one.at_s, one.values)),
        name=name,
        sentence=sentence,
        marked=marked,
        literal=literal,
        time=time,
        day=day,
        told=told,
        title=step_title,
        percent=percent,
        amount=amount,
        duration=duration,
    )
    environment.filters.update(in_words=in_words, observed=observed, question=question)
    environment.filters.update(capitalized=lambda text: text[:1].upper() + text[1:])
    environment.filters.update(since=since, not_chosen=not_chosen, how_it_ended=how_it_ended, waited=waited)
    environment.globals.update(static=static_address, fleet_address=fleet_address, navigation=NAVIGATION)
    environment.globals.update(fleet_row=fleet_row)
    return environment


def fleet_address(**query: str | int) -> str:
    """Return the address of the list of robots; what is empty or usual is left out."""
    wanted = {key: value for key, value in query.items() if value and (key, value) != ("rows", ROWS)}
    return f"/?{urlencode(wanted)}" if wanted else "/"


def name(text: object) -> Markup:
    """Return a name as it is written, kept apart from the direction of the text around it."""
    return Markup('<bdi class="name">{}</bdi>').format(text)


_OTHER_WAY = "\u0590-\u08ff\ufb1d-\ufdff\ufe70-\ufefc"
OTHER_WAY = re.compile(f"([{_OTHER_WAY}]+(?:[\\s_.-]*[{_OTHER_WAY}0-9]+)*)")
"""Words that are written from right to left."""


def sentence(text: object) -> Markup:
    """Return a sentence of ours as people say it: from left to right, whatever the names in it are."""
    parts = OTHER_WAY.split(in_prose(str(text)))
    made = [Markup("<bdi>{}</bdi>" if place % 2 else "{}").format(part) for place, part in enumerate(parts)]
    return Markup('<bdi class="name" dir="ltr">{}</bdi>').format(Markup("").join(made))


def marked(text: str) -> Markup:
    """Return a sentence with what stands between `back quotes` as code."""
    parts = text.split("`")
    if len(parts) % 2 == 0:  # one that is left over is a letter as any other
        return name(text)
    made = [Markup("<code>{}</code>" if place % 2 else "{}").format(part) for place, part in enumerate(parts)]
    return Markup('<bdi class="name">{}</bdi>').format(Markup("").join(made))


def literal(text: str) -> Markup:
    """Return a name with places where a long one may be broken."""
    pieces = re.split(r"(?<=[(_])", text)
    return Markup('<bdi class="name">{}</bdi>').format(Markup("<wbr>").join(pieces))


def time(time_ns: int | None, beside_ns: int | None = None) -> Markup:
    """Return a moment by the clock, of another day with the date; in its title how long ago that was.

    Args:
        beside_ns: a moment whose day is told already, instead of today.
    """
    if time_ns is None:
        return Markup("–")
    moment = datetime.fromtimestamp(time_ns // 1_000_000 / 1000, UTC)
    return Markup('<time datetime="{}" data-ms="{}" title="{} UTC">{}</time>').format(
        moment.isoformat(timespec="milliseconds"),
        time_ns // 1_000_000,
        moment.strftime("%Y-%m-%d %H:%M:%S"),
        clock(time_ns, beside_ns or clocks.time_ns()),
    )


def day(time_ns: int) -> str:
    """Return the day of a moment, in UTC."""
    return f"{datetime.fromtimestamp(time_ns // 10**9, UTC):%Y-%m-%d}"


def told(words: Told) -> Markup:
    """Return a sentence of a headline."""
    return Markup("").join(sentence(each) if isinstance(each, str) else time(each) for each in words)


def in_json(value: object) -> str:
    """Return a value as JSON, which the template escapes."""
    return json.dumps(value, ensure_ascii=False)


def percent(share: float) -> str:
    """Return a share of one in percent; what is not quite nothing or all is not said to be."""
    if 0 < share < 0.01:
        return "< 1 %"
    return "> 99 %" if 0.99 < share < 1 else f"{share:.0%}".replace("%", " %")


def amount(value: float | None, unit: str, digits: int = 2) -> str:
    """Return a number with its unit."""
    return "unknown" if value is None else f"{value:.{digits}f} {unit}"
