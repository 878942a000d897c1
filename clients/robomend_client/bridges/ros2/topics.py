"""A topic that the bridge listens to: with the type and the quality of service that its newest writer has.

So it is heard whatever its writers offer: best effort and volatile; from the start, where all of them are
latched. A topic whose writer changes its type is heard on, by the new one, and that is told.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

from robomend_client.bridges.problems import Problems
from robomend_client.bridges.ros2.dds import Dds, NoDds, RawReader, Sample
from robomend_client.bridges.ros2.discovered import Discovered, Endpoint
from robomend_client.bridges.ros2.names import ros_type, wire_topic

DEPTH = 100
"""Samples of one topic that may come between two looks: 1 kHz, and twice that."""

MOST_WRITERS = 1024

OnSample = Callable[[Endpoint, Sample], None]


class ListenedTopic:
    """One topic, by its name in ROS."""

    def __init__(self, topic: str, on_sample: Sequence[OnSample], problems: Problems) -> None:
        self.topic = topic
        self.wire = wire_topic(topic)
        self.newest_ns: dict[bytes, int] = {}  # writer -> its stamp on what was taken last
        self._on_sample = on_sample
        self._problems = problems
        self._reader: RawReader | None = None
        self._reads: tuple[str, bool] | None = None  # type on the wire, latched
        self._writer: Endpoint | None = None  # the newest
        self._changed_from = ""  # a type, as long as that is to be told

    @property
    def key(self) -> bytes | None:
        """Our reader's key."""
        return None if self._reader is None else self._reader.key

    def follow(self, dds: Dds, found: Discovered) -> None:
        """Listen as its writers speak now."""
        writers = found.writers(self.wire)
        if not writers:
            return
        reads = choose(writers)
        self._writer = writers[-1]
        if self._reads is not None and reads[0] != self._reads[0]:
            self._changed_from = ros_type(self._reads[0])
        if self._changed_from and found.is_named(self._writer):
            what = f"{found.node_of(self._writer)} publishes {ros_type(reads[0])}"
            self._problems.tell(self.topic, f"{what}, where {self._changed_from} came before")
            self._changed_from = ""
        if reads == self._reads:
            return
        self.close()
        self._reads = reads
        try:
            self._reader = dds.reader(self.wire, reads[0], DEPTH, reads[1])
        except NoDds as error:
            self._problems.tell(self.topic, str(error))

    def take(self, found: Discovered, after_ns: Mapping[bytes, int] | None = None) -> bool:
        """Hand on what has come in; return whether anything had.

        With `after_ns`, of each writer in there what is newer than that; of others only what is latched: what
        waited of them came over some time, and would all count as having come now.
        """
        if self._reader is None:
            return False
        samples = self._reader.take()
        others_ns = 0 if self._reads is not None and self._reads[1] else 1 << 62
        for sample in samples:
            writer = found.writer(sample.writer) or self._somebody()
            if len(self.newest_ns) < MOST_WRITERS:
                self.newest_ns[writer.key] = sample.time_ns
            if after_ns is None or sample.time_ns > after_ns.get(writer.key, others_ns):
                for on_sample in self._on_sample:
                    on_sample(writer, sample)
        return bool(samples)

    def _somebody(self) -> Endpoint:
        """Return a writer that has gone, or has just begun and is not discovered yet: it has no name."""
        assert self._writer is not None  # there was one when the reader was made
        return replace(self._writer, key=b"", participant=b"")

    def close(self) -> None:
        if self._reader is not None:
            self._reader.close()
            self._reader = None


def choose(writers: Sequence[Endpoint]) -> tuple[str, bool]:
    """Return the type to listen for, and whether all its writers are latched."""
    kind = writers[-1].type
    same = [writer for writer in writers if writer.type == kind]
    return kind, all(writer.durability and writer.reliable for writer in same)
