"""The page's figures, measured in a real Chromium: `python -m tests.web.figures`. See docs/page.md.

The service is a process of its own, as `robomend serve` starts it, with default options. All of it takes some
five minutes; `--only` picks parts: first, pixel, live, graph, fleet.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import httpx
from playwright.sync_api import Browser, BrowserContext, Page, sync_playwright
from tests import packages
from tests.browser import FLAGS

from robomend.resources import resource

ROBOTS = 2000
COMPONENTS = 40
EVENTS = 25
WATCHED_S = 20.0
LIVE = '#live[data-state="live"]'


def chain(components: int) -> str:
    """Return a model of so many components: devices with their drivers, and nodes in chains behind them."""
    third = components // 3
    lines = ["robomend: 1", "name: chain", "channels: 255", "hardware:"]
    lines += [f"  device{i}: {{channel: {i}}}" if i < 250 else f"  device{i}: {{}}" for i in range(third)]
    lines.append("nodes:")
    lines += [f"  driver{i}: {{drives: [device{i}], publishes: {{raw{i}: []}}}}" for i in range(third)]
    for i in range(components - 2 * third):
        needs = [f"raw{i % third}", *([f"fine{i - third}"] if i >= third else [])]
        lines.append(f"  filter{i}: {{publishes: {{fine{i}: [{', '.join(needs)}]}}}}")
    return "\n".join(lines) + "\n"


@contextmanager
def served() -> Iterator[str]:
    """`robomend serve` in a process of its own: its address."""
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "robomend", "serve", "--port", "0", "--data", folder, "--announce"]
        with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL) as process:
            try:
                assert process.stdout is not None
                yield str(json.loads(process.stdout.readline())["url"])
            finally:
                process.terminate()


def first_load(browser: Browser, url: str) -> dict[str, float]:
    """Return bytes and times of a first visit, with an empty cache."""
    context, page, counted = weighed(browser)
    began = time.perf_counter()
    page.goto(url, wait_until="load")
    loaded = time.perf_counter() - began
    page.wait_for_selector(LIVE)
    live = time.perf_counter() - began
    painted = page.evaluate("performance.getEntriesByName('first-contentful-paint')[0]?.startTime ?? 0")
    answered = page.evaluate("performance.getEntriesByType('navigation')[0].responseStart")
    heap = page.evaluate("performance.memory.usedJSHeapSize")
    nodes = page.evaluate("document.getElementsByTagName('*').length")
    found = {"bytes": float(sum(counted)), "loaded_s": loaded, "live_s": live, "heap": heap, "nodes": nodes}
    found |= {"painted_s": painted / 1000, "answered_s": answered / 1000, "memory": renderer_bytes(browser)}
    context.close()
    return found


def renderer_bytes(browser: Browser) -> float:
    """Return the memory of the browser's process that shows pages, with its part of what is shared."""
    asked = browser.new_browser_cdp_session().send("SystemInfo.getProcessInfo")
    pids = [int(one["id"]) for one in asked["processInfo"] if one["type"] == "renderer"]
    sizes = []
    for pid in pids:
        text = Path(f"/proc/{pid}/smaps_rollup").read_text()
        sizes.append(
            next(int(line.split()[1]) * 1024 for line in text.splitlines() if line.startswith("Pss:"))
        )
    return float(max(sizes, default=0))


def weighed(browser: Browser) -> tuple[BrowserContext, Page, list[int]]:
    """Return a page that counts the bytes that come over the network."""
    context = browser.new_context(viewport={"width": 1280, "height": 900})
    page = context.new_page()
    counted: list[int] = []
    wire = context.new_cdp_session(page)
    wire.send("Network.enable")
    wire.on("Network.dataReceived", lambda event: counted.append(int(event["encodedDataLength"])))
    return context, page, counted


def event_to_pixel(browser: Browser, url: str, api: httpx.Client) -> list[float]:
    """Return, for several changes, the time from sending an observation until the frame that shows it."""
    context = browser.new_context()
    page = context.new_page()
    page.goto(f"{url}/ui/robots/r1")
    page.wait_for_selector(LIVE)
    page.evaluate(
        """() => { globalThis.told = [];
        const state = () => document.querySelector('[data-part="state"] .badge').textContent;
        let last = state();
        new MutationObserver(() => { const now = state();
          if (now === last) return;
          last = now;
          requestAnimationFrame(() => setTimeout(() => told.push(Date.now())));
        }).observe(document.body, {subtree: true, childList: true, characterData: true}); }"""
    )
    times = []
    for number in range(EVENTS):
        time.sleep(4.0)  # a quiet while, after what the last one set off
        sent = time.time()
        observe(api, "r1", "not on(jaguar)" if number % 2 == 0 else "on(jaguar)")
        while page.evaluate("told.length") <= number:  # the page's policy forbids what waits inside it
            page.wait_for_timeout(10)
        times.append(page.evaluate(f"told[{number}]") / 1000 - sent)
    context.close()
    return times


def observe(api: httpx.Client, robot: str, *sentences: str) -> None:
    api.post(f"/robots/{robot}/observations", json={"observations": sentences}).raise_for_status()


def live_bytes(browser: Browser, url: str, api: httpx.Client) -> float:
    """Return the bytes a second of an open page of a robot whose OBS changes five times a second."""
    context, page, counted = weighed(browser)
    page.goto(f"{url}/ui/robots/forty")
    page.wait_for_selector(LIVE)
    page.wait_for_timeout(3000)
    counted.clear()
    ended = threading.Event()

    def report() -> None:
        number = 0
        while not ended.wait(0.2):
            observe(api, "forty", f"{'not ' if number % 2 else ''}ok(raw{number % 13})")
            number += 1

    with ThreadPoolExecutor() as pool:
        reporting = pool.submit(report)
        page.wait_for_timeout(WATCHED_S * 1000)
        ended.set()
        reporting.result()
    context.close()
    return sum(counted) / WATCHED_S


PARTS = ("first", "pixel", "live", "graph", "fleet")


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(prog="python -m tests.web.figures")
    parser.add_argument("--only", default=",".join(PARTS), help="parts, comma-separated")
    wanted = set(parser.parse_args().only.split(","))
    if wanted - set(PARTS):
        parser.error(f"there are {', '.join(PARTS)}")
    print(f"load {os.getloadavg()[0]:.1f}", flush=True)
    with served() as url, sync_playwright() as playwright:
        flags = [flag for flag in FLAGS if not flag.startswith(("--remote", "--headless"))]
        flags.append("--enable-precise-memory-info")
        browser = playwright.chromium.launch(executable_path=packages.chromium(), args=flags)
        with httpx.Client(base_url=f"{url}/api/v1", timeout=60) as api:
            api.put("/models/tedusar", json={"source": resource("examples", "tedusar.yaml").read_text()})
            for name, components in (("forty", COMPONENTS), ("large", 300)):
                api.put(f"/models/{name}", json={"source": chain(components)}).raise_for_status()
                api.put(f"/robots/{name}", json={"model": name, "policy": "observe"}).raise_for_status()
            api.put("/robots/r1", json={"model": "tedusar", "policy": "observe"})
            observe(api, "r1", "on(jaguar)", "ok(scan)")
            observe(api, "large", "not ok(fine7)")
            in_browser(browser, url, api, wanted)
        browser.close()
    print(f"load {os.getloadavg()[0]:.1f}")


def in_browser(browser: Browser, url: str, api: httpx.Client, wanted: set[str]) -> None:
    """Measure what takes a browser."""
    if "first" in wanted:
        tell("/ with 3 robots", first_load(browser, url))
        tell("a robot, 14 components", first_load(browser, f"{url}/ui/robots/r1"))
    if "pixel" in wanted:
        times = sorted(event_to_pixel(browser, url, api))
        median, longest = statistics.median(times) * 1000, times[-1] * 1000
        print(f"observation to pixel, {EVENTS} times: median {median:.0f} ms, longest {longest:.0f} ms")
    if "live" in wanted:
        rate = live_bytes(browser, url, api) / 1000
        print(f"a robot with {COMPONENTS} components, 5 changes/s: {rate:.1f} kB/s", flush=True)
    if "graph" in wanted:
        for again in ("", ", again"):
            tell(f"a robot, 300 components{again}", first_load(browser, f"{url}/ui/robots/large"))
    if "fleet" in wanted:
        fill(url)
        for again in ("", ", again"):
            tell(f"/ with {ROBOTS} robots{again}", first_load(browser, url))


def fill(url: str) -> None:
    """Put robots until there are so many."""

    def put(number: int) -> None:
        config: dict[str, Any] = {"model": "tedusar", "policy": "observe"}
        api.put(f"/robots/robot-{number}", json=config).raise_for_status()
        sentence = ("ok(scan)", "not ok(scan)", "not on(jaguar)", "ok(map)")[number % 4]
        observe(api, f"robot-{number}", sentence)

    with httpx.Client(base_url=f"{url}/api/v1", timeout=120) as api, ThreadPoolExecutor(8) as pool:
        list(pool.map(put, range(ROBOTS - 3)))


def tell(what: str, found: dict[str, float]) -> None:
    print(
        f"{what}: {found['bytes'] / 1000:.0f} kB, loaded in {found['loaded_s']:.2f} s, "
        f"live in {found['live_s']:.2f} s, {found['heap'] / 1e6:.0f} MB of script memory, "
        f"{found['nodes']:.0f} elements; first byte after {found['answered_s']:.2f} s, painted after "
        f"{found['painted_s']:.2f} s, {found['memory'] / 1e6:.0f} MB of the browser's process",
        flush=True,
    )


if __name__ == "__main__":
    main()
