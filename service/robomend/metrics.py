"""What the service counts, for GET /metrics. One registry per application,
so that two live in one process.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable

from prometheus_client import CollectorRegistry, Counter, Gauge, Histogram, generate_latest
from prometheus_client.core import GaugeMetricFamily, Metric
from prometheus_client.registry import Collector

CONTENT_TYPE = "text/plain; version=0.0.4; charset=utf-8"

FINE_S = (0.0005, 0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 30.0)
"""Bucket bounds: the goals are 4, 20 and 200 ms."""

Reading = tuple[tuple[str, ...], float]
"""Label values, and the value."""


class _FiguresRead(Collector):
    """Figures as they were read, on the event loop; their text, which takes longer, is made in a thread."""

    def __init__(self, registry: CollectorRegistry) -> None:
        self._families = [*registry.collect()]

    def collect(self) -> list[Metric]:
        return self._families


class _OnDemand(Collector):
    """A gauge that is read when somebody asks, so that nothing keeps it up to date meanwhile."""

    def __init__(
        self, name: str, text: str, labels: tuple[str, ...], read: Callable[[], list[Reading]]
    ) -> None:
        self._name, self._text, self._labels, self._read = name, text, labels, read

    def collect(self) -> list[GaugeMetricFamily]:
        family = GaugeMetricFamily(self._name, self._text, labels=self._labels)
        for labels, value in self._read():
            family.add_metric(labels, value)
        return [family]


class Metrics:
    """The service's instruments; the names are part of the interface and listed in docs/metrics.md."""

    def __init__(self) -> None:
        self.registry = CollectorRegistry()
        self._requests = self._counter("robomend_requests", "HTTP requests", "method", "route", "status")
        self._request_s = self._histogram(
            "robomend_request_seconds",
            "from the head of a request to the end of its answer, streams and long polls left out",
            "route",
        )
        self.loop_delay_s = self._histogram(
            "robomend_loop_delay_seconds", "what the event loop took to come to a new task, sampled"
        )
        self.observations = self._counter("robomend_observations", "literals accepted and durable", "way")
        self.diagnoses = self._counter("robomend_diagnoses", "diagnoses by where they were made", "place")
        self.diagnosis_s = self._histogram("robomend_diagnosis_seconds", "of the engine alone")
        self.published_s = self._histogram(
            "robomend_observation_to_diagnosis_seconds", "from an accepted change to its published diagnosis"
        )
        self.failures = self._counter(
            "robomend_diagnosis_failures", "diagnoses that an engine failed to give", "code"
        )
        self.refused = self._counter("robomend_refused", "requests beyond a limit", "limit")
        self.streams = Gauge("robomend_event_streams", "open event streams", registry=self.registry)
        self.repairs = self._counter(
            "robomend_repair_changes", "repairs by the state that they came to", "state"
        )
        self.changes = self._counter(
            "robomend_configuration_changes", "changes of configurations by the state they came to", "state"
        )
        self.actions = self._counter("robomend_actions", "actions by name and result code", "name", "code")
        self.moments = self._counter("robomend_moments", "moments of faults that came in")
        self.moment_bytes = self._counter("robomend_moment_bytes", "bytes of moments that came in", "of")
        self.notifications = self._counter(
            "robomend_notifications", "notifications by what came of a try to deliver them", "outcome"
        )

    def _counter(self, name: str, text: str, *labels: str) -> Counter:
        return Counter(name, text, labels, registry=self.registry)

    def _histogram(self, name: str, text: str, *labels: str) -> Histogram:
        return Histogram(name, text, labels, buckets=FINE_S, registry=self.registry)

    def request(self, method: str, route: str, status: int, elapsed_s: float | None) -> None:
        """Count a request; `elapsed_s` is None where its time says nothing, as of a long poll."""
        self._requests.labels(method, route, status).inc()
        if elapsed_s is not None:
            self._request_s.labels(route).observe(elapsed_s)

    def on_demand(
        self, name: str, text: str, labels: tuple[str, ...], read: Callable[[], list[Reading]]
    ) -> None:
        """Register a gauge that is read when /metrics is."""
        self.registry.register(_OnDemand(name, text, labels, read))

    async def text(self) -> bytes:
        """Return everything in Prometheus' text format: read now, and written in a thread."""
        return await asyncio.to_thread(generate_latest, _FiguresRead(self.registry))
