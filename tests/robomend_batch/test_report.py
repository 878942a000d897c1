"""What is made of results: a report that is one file and needs nothing else, SQL over them, comparisons."""

from __future__ import annotations

import json
import re
from html.parser import HTMLParser
from pathlib import Path

import pytest
from playwright.sync_api import Browser
from tests.browser import PATIENCE_MS, browser, chromium
from tests.robomend_batch.running import TEDUSAR, batch_run, ndjson

from robomend.cli.commands import run
from robomend_batch.commands import batch
from robomend_batch.report import draw
from robomend_batch.results import Interval
from robomend_client.observers.base import SECOND

__all__ = ("browser", "chromium")  # fixtures


@pytest.fixture
def out(tmp_path: Path) -> Path:
    """Two logs with the same fault, one of them with another, and one that is refused."""
    drive = (0, "ok(odom)"), (2, "not ok(odom)"), (5, "ok(odom)"), (9, "ok(odom)")
    one = ndjson(tmp_path / "<one>.ndjson", *drive)
    drive = (0, "not ok(odom)"), (1, "ok(odom)"), (3, "not on(hokuyo)"), (4, "on(hokuyo)")
    two = ndjson(tmp_path / "two.ndjson", *drive)
    bad = tmp_path / "bad.ndjson"
    bad.write_text('{"time": 0, "literal": "ok(<script>)"}\n')
    assert batch_run(tmp_path / "out", one, two, bad) == 2
    return tmp_path / "out"


def written(out: Path) -> str:
    assert run(["report", str(out)], batch) == 0
    return (out / "report.html").read_text()


def test_the_report_says_which_fault_is_in_which_logs_and_why(out: Path) -> None:
    text = written(out)
    faults = re.findall(r"<h3>(.*?)</h3><div class='muted'>(.*?) together", text)
    assert faults == [
        ("jaguar, or jaguar_node", "in 2 logs, 2 intervals, 4.0 s"),
        ("hokuyo", "in 1 log, 1 interval, 1.0 s"),
    ]
    assert "odom should be ok because jaguar and jaguar_node are taken to be healthy" in text
    assert "hokuyo explains not on(hokuyo)" in text
    assert text.count("<svg") == 2
    assert "<span class='tag'>refused</span>" in text


def test_the_report_needs_nothing_else_and_quotes_what_is_in_logs(out: Path) -> None:
    text = written(out)
    assert not re.search(r"<(script|link|img|iframe)|url\(|@import", text)
    assert set(re.findall(r"https?://[^'\" )]+", text)) == {
        "http://www.w3.org/2000/svg"
    }  # a name, not fetched
    assert "&lt;one&gt;.ndjson" in text
    opened: list[str] = []

    class Balance(HTMLParser):
        def handle_starttag(self, tag: str, attrs: object) -> None:
            if tag not in ("meta", "rect", "line"):
                opened.append(tag)

        def handle_endtag(self, tag: str) -> None:
            if tag not in ("rect", "line"):
                assert opened.pop() == tag

    Balance().feed(text)
    assert opened == []


@pytest.mark.parametrize("width", [390, 1280])
def test_the_report_is_as_wide_as_the_screen_and_asks_nobody(width: int, out: Path, browser: Browser) -> None:
    written(out)
    context = browser.new_context(viewport={"width": width, "height": 900}, offline=True)
    try:
        page = context.new_page()
        asked: list[str] = []
        page.on("request", lambda request: asked.append(request.url))
        page.goto(f"file://{out}/report.html", timeout=PATIENCE_MS)
        wide, seen = page.evaluate("(r => [r.scrollWidth, r.clientWidth])(document.documentElement)")
        assert wide == seen <= width
        assert page.get_by_text("refused").first.is_visible()
        assert asked == [f"file://{out}/report.html"]
    finally:
        context.close()


def test_a_timeline_shows_what_is_bad_suspected_good_and_unknown() -> None:
    record = {"span_ns": {"healthy": 10 * SECOND}}
    intervals = [
        Interval(0, 0, 2 * SECOND, "unknown", (), ()),
        Interval(0, 2 * SECOND, 4 * SECOND, "healthy", ((),), ()),
        Interval(0, 4 * SECOND, 6 * SECOND, "faulty", (("a", "b"), ("a", "c")), ()),
        Interval(0, 6 * SECOND, 6 * SECOND + 1, "faulty", (("b",),), ()),  # too short to be seen
        Interval(0, 6 * SECOND + 1, 10 * SECOND, "healthy", ((),), ()),
    ]
    drawn = draw(record, intervals, ("a", "b", "c", "d"))
    told = re.findall(r"<title>(\w): (\w+), ([\d.]+) s to ([\d.]+) s</title>", drawn)
    assert ("a", "good", "2.00", "4.00") in told
    assert ("a", "bad", "4.00", "6.00") in told
    assert ("b", "suspect", "4.00", "6.00") in told
    assert ("b", "bad", "6.00", "6.01") in told
    assert ("c", "good", "6.00", "10.00") in told
    assert {name for name, *_ in told} == {"a", "b", "c"}
    assert min(float(start) for _, _, start, _ in told) == 2.0


def test_time_that_goes_back_is_drawn_behind_what_was_before(tmp_path: Path) -> None:
    drive = (100, "ok(odom)"), (110, "ok(odom)"), (0, "not ok(odom)"), (5, "ok(odom)")
    log = ndjson(tmp_path / "a.ndjson", *drive)
    assert batch_run(tmp_path / "out", log) == 0
    text = written(tmp_path / "out")
    assert "time begins again" in text
    assert "jaguar: suspect, 10.00 s to 15.00 s" in text


def links(text: str, part: str) -> dict[str, str]:
    """Return the links of a part of the report: log -> where it leads."""
    found = re.search(part, text, re.DOTALL)
    assert found is not None
    return {name: to for to, name in re.findall(r"<a href='#(\w+)'>[^<]*?(\w+)\.ndjson</a>", found[0])}


def test_each_of_many_logs_with_a_fault_is_drawn_and_the_fault_leads_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    count = 130
    for number in range(count):  # the longest faults come first
        ends = (0, "not ok(odom)"), (1 + number, "ok(odom)"), (200, "ok(odom)")
        ndjson(tmp_path / f"log{number:03}.ndjson", *ends)
    assert batch_run(tmp_path / "out", tmp_path) == 0
    text = written(tmp_path / "out")
    names = {f"log{number:03}" for number in range(count)}
    of_fault = links(text, rf"<summary>its {count} logs</summary>.*?</details>")
    assert of_fault.keys() == names
    assert of_fault == links(text, "<table>.*</table>")
    drawn = re.findall(r"<details id='(\w+)'( open)?><summary><b>[^<]*?(\w+)\.ndjson</b>", text)
    assert {name: anchor for anchor, _, name in drawn} == of_fault
    assert [bool(opened) for _, opened, _ in drawn] == [True] * 100 + [False] * 30

    monkeypatch.setattr("robomend_batch.report.TIMELINES", 3)
    text = written(tmp_path / "out")
    assert text.count("<svg") == 3
    assert "127 more, of shorter faults, are drawn by <code>robomend-batch report OUT --log NAME" in text
    some = tmp_path / "some.html"
    asked = ["report", str(tmp_path / "out"), "--log", "log00?.ndjson", "--log", "log012.ndjson"]
    monkeypatch.undo()
    assert run([*asked, "--file", str(some)], batch) == 0
    shown = {f"log{number:03}" for number in (*range(10), 12)}
    assert links(some.read_text(), "<table>.*</table>").keys() == shown
    assert "119 other logs of the run are left out" in some.read_text()
    assert run(asked, batch) == 2  # it would replace the report of all
    assert run([*asked, "--log", "none.bag", "--file", str(some)], batch) == 2


def test_what_a_report_bounds_is_counted_and_told_elsewhere(
    out: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("robomend_batch.report.FAULTS", 1)
    assert "<summary>1 more fault</summary><div><b>hokuyo</b> in 1 log, longest 1.0 s in" in written(out)
    monkeypatch.setattr("robomend_batch.report.OTHERS", 0)
    monkeypatch.setattr("robomend_batch.report.NAMED", 1)
    monkeypatch.setattr("robomend_batch.report.DRAWN_BYTES", 0)
    text = written(out)
    assert text.count("1 more are named by <code>robomend-batch compare OUT</code>") == 2
    assert "<svg" not in text
    assert "2 more, of shorter faults" in text
    capsys.readouterr()
    assert run(["compare", str(out)], batch) == 0
    told = capsys.readouterr().out
    assert "hokuyo" in told
    assert "two.ndjson" in told


def test_a_run_without_faults_says_so(tmp_path: Path) -> None:
    assert batch_run(tmp_path / "out", ndjson(tmp_path / "a.ndjson", (0, "ok(odom)"), (1, "ok(odom)"))) == 0
    assert "No log shows a fault." in written(tmp_path / "out")


def test_sql_over_results_and_logs(out: Path, capsys: pytest.CaptureFixture[str]) -> None:
    asked = "SELECT state, count(*) AS n FROM results GROUP BY state ORDER BY state"
    assert run(["query", str(out), asked, "--format", "ndjson"], batch) == 0
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert lines == [{"state": "faulty", "n": 3}, {"state": "healthy", "n": 4}]
    assert run(["query", str(out), "SELECT state FROM logs", "--format", "csv"], batch) == 0
    assert sorted(capsys.readouterr().out.split()) == ["ok", "ok", "refused", "state"]
    assert run(["query", str(out), "SELECT bad FROM results"], batch) == 0
    assert "jaguar_node" in capsys.readouterr().out
    assert run(["query", str(out), "SELECT nothing FROM nowhere"], batch) == 2


@pytest.mark.parametrize("command", [["report"], ["query"]])
def test_a_folder_without_results_is_refused(command: list[str], tmp_path: Path) -> None:
    assert run([*command, str(tmp_path), *(["SELECT 1"] if command == ["query"] else [])], batch) == 2


SILENT = (0, "ok(odom)"), (2, "not ok(odom)"), (5, "ok(odom)"), (9, "ok(odom)")


def printed(capsys: pytest.CaptureFixture[str]) -> list[dict[str, object]]:
    return [json.loads(line) for line in capsys.readouterr().out.splitlines()]


def test_logs_with_the_same_faults_are_a_group(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    files = [
        ndjson(tmp_path / "a.ndjson", *SILENT),
        ndjson(tmp_path / "b.ndjson", (0, "not ok(odom)"), (1, "ok(odom)"), (2, "not ok(odom)")),
        ndjson(tmp_path / "c.ndjson", *SILENT, (10, "not on(hokuyo)")),
        ndjson(tmp_path / "d.ndjson", (0, "ok(odom)")),
    ]
    assert batch_run(tmp_path / "out", *files) == 0
    assert run(["compare", str(tmp_path / "out"), "--format", "ndjson"], batch) == 0
    jaguar, hokuyo = [["jaguar"], ["jaguar_node"]], [["hokuyo"]]
    found = [(group["faults"], len(list(str(group["logs"]).split(",")))) for group in printed(capsys)]
    assert found == [([jaguar], 2), ([hokuyo, jaguar], 1), ([], 1)]
    assert run(["compare", str(tmp_path / "out")], batch) == 0
    assert "jaguar, or jaguar_node: 2 logs" in capsys.readouterr().out


def test_where_another_model_changes_the_verdict_is_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    files = [ndjson(tmp_path / f"{name}.ndjson", *SILENT) for name in "ab"]
    other = tmp_path / "other.yaml"
    text = Path(TEDUSAR).read_text().replace("jaguar_node: {drives: [jaguar], ", "jaguar_node: {")
    other.write_text(text)
    assert other.read_text() != Path(TEDUSAR).read_text()
    assert batch_run(tmp_path / "one", *files) == 0
    assert batch_run(tmp_path / "two", files[0], model=other) == 0
    asked = ["diff", str(tmp_path / "one"), str(tmp_path / "two")]
    assert run([*asked, "--format", "ndjson", "--fail-on-difference"], batch) == 1
    found = printed(capsys)
    assert found[0] == {
        "log": str(files[0]),
        "segment": 0,
        "start_ns": 2 * SECOND,
        "end_ns": 5 * SECOND,
        "before": {"state": "faulty", "bad": [["jaguar"], ["jaguar_node"]]},
        "after": {"state": "faulty", "bad": [["jaguar_node"]]},
    }
    assert {line["log"] for line in found[1:]} == {str(files[1])}
    assert all(line["after"] is None for line in found[1:])
    assert run(asked, batch) == 0
    first = capsys.readouterr().out.splitlines()[0]
    at, verdicts = "1970-01-01 00:00:02.000 UTC for 3.0 s", "jaguar, or jaguar_node -> jaguar_node"
    assert first == f"{files[0]}  {at}: {verdicts}"


def test_a_run_does_not_differ_from_itself(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert batch_run(tmp_path / "out", ndjson(tmp_path / "a.ndjson", *SILENT)) == 0
    out = str(tmp_path / "out")
    assert run(["diff", out, out, "--fail-on-difference"], batch) == 0
    assert capsys.readouterr().out == ""


def test_runs_without_a_log_in_common_are_refused(tmp_path: Path) -> None:
    for name in ("one", "two"):
        assert batch_run(tmp_path / name, ndjson(tmp_path / f"{name}.ndjson", *SILENT)) == 0
    assert run(["diff", str(tmp_path / "one"), str(tmp_path / "two")], batch) == 2
