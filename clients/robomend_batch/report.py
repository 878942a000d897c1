"""The report: one HTML file that needs nothing else, no network and no script.

figures of the run · faults, those of most logs first, with their explanation and their logs · all logs · a
timeline of each log with a fault, as in the paper's figures 5 and 6

What a bound leaves out is counted, with the command that shows it.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from html import escape

from robomend.diagnosis.result import Options
from robomend.errors import InputError
from robomend.oneshots.result_json import result_json
from robomend.oneshots.warm_model import WarmModel, question
from robomend.web.timeline import BAD, GOOD, Mark, Span, Timeline, svg
from robomend_batch.answers import FAULTY
from robomend_batch.one_log import Record
from robomend_batch.results import Bad, Interval, Results, moment, record_span_ns, short_times, told
from robomend_client.counts import counted

# --- the faults of a run: equal diagnoses are one fault, in whichever logs it shows.

EXPLAIN_S = 2.0
"""For the explanation of one fault."""


@dataclass
class Fault:
    """Diagnoses that some intervals share; none: the model cannot explain what was seen."""

    bad: Bad
    logs: set[str] = field(default_factory=set)
    intervals: int = 0
    span_ns: int = 0
    longest: tuple[str, Interval] | None = None

    def add(self, log: str, interval: Interval) -> None:
        """Count an interval."""
        self.logs.add(log)
        self.intervals += 1
        self.span_ns += interval.span_ns
        if self.longest is None or interval.span_ns > self.longest[1].span_ns:
            self.longest = log, interval


def find_faults(told: Iterable[tuple[str, Interval]]) -> list[Fault]:
    """Return the faults of intervals with their logs: those of most logs first, then the longest."""
    found: dict[Bad, Fault] = {}
    for log, interval in told:
        if interval.state in FAULTY:
            found.setdefault(interval.bad, Fault(interval.bad)).add(log, interval)
    return sorted(found.values(), key=lambda fault: (-len(fault.logs), -fault.span_ns, fault.bad))


def explain(results: Results, faults: Iterable[Fault]) -> list[list[str]]:
    """Return sentences for each fault: what clashed in its longest interval, and what explains it.

    Of windows that were explained together, what was seen in them: no single set of observations shows it.
    """
    if "together" in results.manifest.settings:
        longest = [fault.longest[1] for fault in faults if fault.longest is not None]
        return [[f"Seen in one window: {', '.join(one.observations)}."] for one in longest]
    system = results.system
    sentences = []
    unknown = results.manifest.settings["unknown"]
    with WarmModel(system, options=Options(timeout_s=EXPLAIN_S), unknown=unknown) as model:
        for fault in faults:
            assert fault.longest is not None
            try:
                result = model.ask(
                    question(fault.longest[1].observations, system.vocabulary, unknown=unknown)
                )
                said = result_json(result.result)
            except InputError as error:
                sentences.append([str(error)])
                continue
            sentences.append(
                [conflict["text"] for conflict in said["conflicts"]]
                + [diagnosis["text"] for diagnosis in said["diagnoses"][:5] if diagnosis["text"]]
            )
    return sentences


FAULTS, OTHERS, ROWS = 20, 500, 24
"""Faults that are explained, those that are named beside, and components of a timeline."""

NAMED = 1000
"""Logs of a fault that are named."""

OPEN, TIMELINES = 100, 2000
"""Timelines that are open, and all of them: those of the longest faults come first."""

READINGS = 20
"""Of a log, beside its timeline."""

DRAWN_BYTES = 64 << 20
"""Of timelines together."""

DRAWN_BY = "are drawn by <code>robomend-batch report OUT --log NAME --file FILE</code>"
NAMED_BY = "are named by <code>robomend-batch compare OUT</code>"

COLUMNS = 880
"""Moments of a timeline that can be told apart."""

CONTRADICTORY = "#6b4c9a"
UNKNOWN = "#d5dae0"
DEGRADED = "#e0a030"
COLOURS = {
    "healthy": GOOD,
    "faulty": BAD,
    "degraded": DEGRADED,
    "contradictory": CONTRADICTORY,
    "unknown": UNKNOWN,
}

WORDS = {
    "ok": "",
    "unchecked": "without a checksum",
    "ended-early": "ended early",
    "bad": "read in part",
    "refused": "refused",
    "lost": "lost",
}

STYLE = """
:root{color-scheme:light}
body{font:15px/1.5 system-ui,"Segoe UI",Roboto,Helvetica,Arial,sans-serif}
body{color:#1f2933;background:#f7f8fa;margin:0}
main{max-width:1120px;margin:0 auto;padding:28px 20px 60px}
h1{font-size:26px;margin:0 0 2px}h2{font-size:19px;margin:36px 0 10px}
.muted{color:#616e7c}.figures{display:flex;flex-wrap:wrap;gap:12px;margin:18px 0}
.figure{background:#fff;border:1px solid #e4e7eb;border-radius:8px;padding:10px 16px;min-width:110px}
.figure b{display:block;font-size:22px}.figure.bad b{color:#b23a48}
.card{background:#fff;border:1px solid #e4e7eb;border-radius:8px;padding:12px 16px;margin:0 0 10px}
.card{overflow-wrap:anywhere}.card h3{margin:0;font-size:16px}.card ul{margin:6px 0 0;padding-left:20px}
table{border-collapse:collapse;width:100%;background:#fff;border:1px solid #e4e7eb;border-radius:8px}
th{text-align:left;font-weight:600;color:#616e7c;font-size:13px}
th,td{padding:7px 10px;border-bottom:1px solid #eef0f3;vertical-align:top}
td.n{text-align:right;white-space:nowrap;font-variant-numeric:tabular-nums}
td.name{overflow-wrap:anywhere;min-width:180px}
.bar{display:flex;width:190px;height:12px;border-radius:3px;overflow:hidden;background:#eef0f3;margin-top:5px}
.bar i{display:block}
.tag{background:#fbe9e7;color:#8c2f23;border-radius:4px;padding:1px 7px;font-size:12px;white-space:nowrap}
.legend span{margin-right:14px;white-space:nowrap}
.legend i{display:inline-block;width:12px;height:12px;border-radius:2px;margin-right:5px}
details{background:#fff;border:1px solid #e4e7eb;border-radius:8px;margin:0 0 10px;padding:8px 14px}
summary{cursor:pointer;overflow-wrap:anywhere}svg{max-width:100%;height:auto}
details.logs{border:0;margin:6px 0 0;padding:0;background:none}details.logs ul{columns:260px}
.problem,.note{font-size:13px;color:#616e7c;overflow-wrap:anywhere}.problem{color:#8c2f23}
@media print{details{break-inside:avoid}}
@media screen and (max-width:760px){
main{padding:18px 12px 40px}.figures{gap:8px}.figure{padding:8px 12px;min-width:84px}.figure b{font-size:18px}
table,tbody{display:block}thead{display:none}td,td.name{border:0;padding:0;min-width:0}
tr{display:flex;flex-wrap:wrap;gap:2px 14px;padding:9px 12px;border-bottom:1px solid #eef0f3}
td.name,td.spread{width:100%}td:empty{display:none}td.n.fault::after{content:" with a fault"}.bar{width:100%}
details{overflow-x:auto}svg{min-width:620px}
}
"""


def report(results: Results, title: str) -> str:
    """Return the report as HTML."""
    faults = find_faults(
        (record["log"], interval) for record in results.records for interval in results.intervals(record)
    )
    shown = faults[:FAULTS]
    sentences = explain(results, shown)
    faulty = [record for record in results.records if _faulty(record)]
    faulty.sort(key=lambda record: (-record_span_ns(record, *FAULTY), record["log"]))
    drawn = _timelines(results, faulty)
    anchors = {record["log"]: f"log{number}" for number, record in enumerate(faulty[: len(drawn)])}
    parts = [
        "<!doctype html><html lang='en'><head><meta charset='utf-8'>",
        "<meta name='viewport' content='width=device-width,initial-scale=1'>",
        f"<title>{escape(title)}</title><style>{STYLE}</style></head><body><main>",
        f"<h1>{escape(title)}</h1><div class='muted'>{escape(_about(results))}</div>",
        _figures(results.records, faults),
        "<h2>Faults</h2>",
        *(_fault(fault, said, anchors) for fault, said in zip(shown, sentences, strict=True)),
        _others(faults[FAULTS:], anchors),
        "" if faults else "<p class='muted'>No log shows a fault.</p>",
        "<h2>Logs</h2>",
        _legend(),
        _table(results, anchors),
        *(["<h2>Timelines of the logs with faults</h2>"] if faulty else []),
        *drawn,
        _rest(len(faulty) - len(drawn), f"more, of shorter faults, {DRAWN_BY}"),
        "</main></body></html>\n",
    ]
    return "\n".join(parts)


def _about(results: Results) -> str:
    settings = results.manifest.settings
    minimal = f"minimal diagnoses by {settings['minimal']}"
    left_out = len(results.manifest.records) - len(results.records)
    some = f"; {left_out} other logs of the run are left out" if left_out else ""
    return f"model {results.system.name}; {minimal}; robomend {settings['version']}{some}"


def _faulty(record: Record) -> bool:
    return any(record["intervals"].get(state) for state in FAULTY)


def _figures(records: Sequence[Record], faults: Sequence[Fault]) -> str:
    faulty = sum(map(_faulty, records))
    bad = sum(record["state"] not in ("ok", "unchecked") for record in records)
    figures = [
        (str(len(records)), "logs", False),
        (str(faulty), "show a fault", faulty > 0),
        (str(len(faults)), "different faults", False),
        (short_times(sum(map(record_span_ns, records))), "observed", False),
        (short_times(sum(record_span_ns(record, *FAULTY) for record in records)), "with a fault", False),
        (str(bad), "bad logs", bad > 0),
    ]
    cells = [
        f"<div class='figure{' bad' if warns else ''}'><b>{escape(value)}</b>{escape(words)}</div>"
        for value, words, warns in figures
    ]
    return f"<div class='figures'>{''.join(cells)}</div>"


def _fault(fault: Fault, sentences: Iterable[str], anchors: dict[str, str]) -> str:
    where = f"in {_count(fault)}, {counted(fault.intervals, 'interval')}"
    said = "".join(f"<li>{escape(sentence)}</li>" for sentence in dict.fromkeys(sentences))
    return (
        f"<div class='card'><h3>{escape(_name(fault))}</h3><div class='muted'>{where}, "
        f"{escape(short_times(fault.span_ns))} together; {_longest(fault, anchors)}</div><ul>{said}</ul>"
        f"{_logs(fault, anchors)}</div>"
    )


def _count(fault: Fault) -> str:
    return counted(len(fault.logs), "log")


def _name(fault: Fault) -> str:
    return told(fault.bad) if fault.bad else "what the model cannot explain, whatever is abnormal"


def _longest(fault: Fault, anchors: dict[str, str]) -> str:
    assert fault.longest is not None
    log, interval = fault.longest
    return f"longest {escape(short_times(interval.span_ns))} in {_link(log, anchors)}"


def _logs(fault: Fault, anchors: dict[str, str]) -> str:
    """Return the names of a fault's logs, to be unfolded; of one there is a link already."""
    if len(fault.logs) == 1:
        return ""
    names = "".join(f"<li>{_link(log, anchors)}</li>" for log in sorted(fault.logs)[:NAMED])
    title = f"<summary>its {len(fault.logs)} logs</summary>"
    rest = _rest(len(fault.logs) - NAMED, f"more {NAMED_BY}")
    return f"<details class='logs'>{title}<ul>{names}</ul>{rest}</details>"


def _others(faults: Sequence[Fault], anchors: dict[str, str]) -> str:
    """Return the faults that are not explained, to be unfolded."""
    if not faults:
        return ""
    lines = "".join(
        f"<div><b>{escape(_name(fault))}</b> in {_count(fault)}, {_longest(fault, anchors)}"
        f"{_logs(fault, anchors)}</div>"
        for fault in faults[:OTHERS]
    )
    rest = _rest(len(faults) - OTHERS, f"more {NAMED_BY}")
    many = counted(len(faults), "more fault")
    return f"<details><summary>{many}</summary>{lines}{rest}</details>"


def _link(log: str, anchors: dict[str, str]) -> str:
    return f"<a href='#{anchors[log]}'>{escape(log)}</a>" if log in anchors else escape(log)


def _rest(count: int, words: str) -> str:
    return f"<p class='muted'>{count} {words}.</p>" if count > 0 else ""


def _legend() -> str:
    marks = [f"<span><i style='background:{colour}'></i>{state}</span>" for state, colour in COLOURS.items()]
    return f"<p class='legend muted'>{''.join(marks)}</p>"


def _table(results: Results, anchors: dict[str, str]) -> str:
    rows = []
    for record in results.records:
        state = WORDS[record["state"]]
        tag = f" <span class='tag'>{state}</span>" if state else ""
        whole = max(record_span_ns(record), 1)
        lasts = "" if record["start_ns"] is None else escape(short_times(record_span_ns(record)))
        bar = "".join(
            f"<i style='width:{100 * record_span_ns(record, name) / whole:.2f}%;background:{colour}'></i>"
            for name, colour in COLOURS.items()
            if record_span_ns(record, name)
        )
        bar = f"<div class='bar'>{bar}</div>" if lasts else ""
        problems = "".join(
            f"<div class='{'problem' if problem['bad'] else 'note'}'>"
            f"{escape(_inside(problem['place'], record['file']))}{escape(problem['reason'])}"
            f"{_times(problem['count'])}</div>"
            for problem in record["problems"]
        )
        began = "" if record["start_ns"] is None else escape(moment(record["start_ns"]))
        faulty = record_span_ns(record, *FAULTY)
        rows.append(
            f"<tr><td class='name'>{_link(record['log'], anchors)}{tag}{problems}</td><td>{began}</td>"
            f"<td class='n'>{lasts}</td><td class='spread'>{bar}</td>"
            f"<td class='n fault'>{escape(short_times(faulty)) if _faulty(record) else ''}</td></tr>"
        )
    head = "<tr><th>log</th><th>began (UTC)</th><th>lasts</th><th></th><th>with a fault</th></tr>"
    return f"<table><thead>{head}</thead><tbody>{''.join(rows)}</tbody></table>"


def _times(count: int) -> str:
    return f" ({count} times)" if count > 1 else ""


def _inside(place: str, file: str) -> str:
    """Return where in its file a problem is."""
    inside = place.removeprefix(file).strip(": ")
    return f"{inside}: " if inside else ""


def _timelines(results: Results, faulty: Sequence[Record]) -> list[str]:
    """Return the timelines of these logs, as far as the bounds allow; the first ones are open."""
    components = results.system.cnf.components
    found: list[str] = []
    left = DRAWN_BYTES
    for number, record in enumerate(faulty[:TIMELINES]):
        drawn = draw(record, results.intervals(record), components)
        left -= len(drawn)
        if left < 0:
            break
        drawn += _readings(record)
        opened = " open" if number < OPEN else ""
        title = f"<summary><b>{escape(record['log'])}</b></summary>"
        found.append(f"<details id='log{number}'{opened}>{title}{drawn}</details>")
    return found


def _readings(record: Record) -> str:
    """Return what was measured where literals turned bad, the first ones."""
    found = record.get("readings") or []
    lines = "".join(
        f"<li>{escape(moment(one['time_ns']))} {escape(one['literal'])}: {escape(one['reading'])}</li>"
        for one in found[:READINGS]
    )
    more = _rest(len(found) - READINGS, "more are in <code>logs.ndjson</code>")
    return f"<ul class='muted'>{lines}</ul>{more}" if lines else ""


def draw(record: Record, intervals: Iterable[Interval], components: Sequence[str]) -> str:
    """Return the timeline of a log: the components that are ever blamed, bad, suspected or good."""
    intervals = list(intervals)
    start_ns = last_ns = intervals[0].start_ns
    step_ns = max(record_span_ns(record) // COLUMNS, 1)
    offset_ns, segment = 0, intervals[0].segment
    states: dict[str, list[Span]] = {}
    marks: list[Mark] = []
    known: list[tuple[float, float]] = []
    for interval in intervals:
        if interval.segment != segment:  # segments one behind the other, however far back time went
            offset_ns += last_ns - interval.start_ns
            segment = interval.segment
            marks.append(Mark((interval.start_ns + offset_ns - start_ns) / 1e9, "time begins again"))
        last_ns = interval.end_ns
        begin_s = (interval.start_ns + offset_ns - start_ns) / 1e9
        # What is too short to be seen is drawn as wide as a moment: a fault must not vanish.
        wide_ns = max(interval.span_ns, step_ns if interval.state in FAULTY else 0)
        end_s = begin_s + wide_ns / 1e9
        if interval.state == "contradictory" and len(marks) < 20:
            marks.append(Mark(begin_s, "the model cannot explain this"))
        if interval.state in ("healthy", "faulty", "degraded"):
            _extend(known, begin_s, end_s)
        blamed = {name for bad in interval.bad for name in bad}
        always = set(interval.bad[0]).intersection(*map(set, interval.bad)) if interval.bad else set()
        for name in blamed:
            _join(states.setdefault(name, []), Span(begin_s, end_s, True, name not in always), step_ns / 1e9)
    order = {name: number for number, name in enumerate(components)}
    blamed_s = {name: sum(span.end_s - span.start_s for span in spans) for name, spans in states.items()}
    names = sorted(states, key=lambda name: (-blamed_s[name], order.get(name, 0)))
    shown = sorted(names[:ROWS], key=lambda name: order.get(name, 0))
    rows = [(name, _with_good(states[name], known)) for name in shown]
    faulty, whole = record_span_ns(record, *FAULTY), record_span_ns(record)
    title = f"with a fault for {short_times(faulty)} of {short_times(whole)}"
    length_s = (last_ns + offset_ns - start_ns) / 1e9
    more = f"; {len(names) - ROWS} more were blamed" if len(names) > ROWS else ""
    others = len(components) - len(names)
    subtitle = f"{moment(start_ns)} UTC; {others} other components were blamed by no diagnosis{more}"
    return svg(Timeline(title, subtitle, rows, (), marks, length_s))


def _extend(spans: list[tuple[float, float]], begin_s: float, end_s: float) -> None:
    if spans and begin_s - spans[-1][1] < 1e-9:
        spans[-1] = spans[-1][0], max(end_s, spans[-1][1])
    else:
        spans.append((begin_s, end_s))


def _join(spans: list[Span], span: Span, step_s: float) -> None:
    """Add a span; one that cannot be told from its equal before it is joined to it."""
    if spans:
        before = spans[-1]
        near = span.start_s - before.end_s < step_s
        if near and before.only_suspect == span.only_suspect:
            spans[-1] = Span(before.start_s, max(span.end_s, before.end_s), True, span.only_suspect)
            return
        if span.start_s < before.end_s:
            spans[-1] = Span(before.start_s, span.start_s, True, before.only_suspect)
    spans.append(span)


def _with_good(spans: Sequence[Span], known: Sequence[tuple[float, float]]) -> list[Span]:
    """Return the spans of a component with those in which it was good between them; gaps are unknown."""
    found: list[Span] = []
    for begin_s, end_s in known:
        at_s = begin_s
        for span in spans:
            if span.end_s <= begin_s or span.start_s >= end_s:
                continue
            if span.start_s > at_s:
                found.append(Span(at_s, span.start_s, False))
            at_s = max(at_s, span.end_s)
        if at_s < end_s:
            found.append(Span(at_s, end_s, False))
    return sorted([*found, *spans], key=lambda span: (span.start_s, span.end_s))
