"""Recorder: a thread that writes the messages of live topics, fed by a bounded queue."""

from __future__ import annotations

import logging
import queue
import threading
import time
from collections import Counter
from collections.abc import Callable, Sequence
from typing import NamedTuple, Protocol, TypeAlias

from rosld.adapters.model import Sample
from rosld.adapters.model.schema import latched_depth

log = logging.getLogger("rosld.history")
MAX_QUEUED = 64 * 1024 * 1024
"""Maximum bytes of queued messages; further ones are dropped and counted."""
SAMPLE_OVERHEAD = 400
"""Bytes of a message in addition to its data: its objects, times and numbers."""
_PERIOD = 0.25
"""Seconds between writes."""


class Sink(Protocol):
    """Destination of messages. All methods run on the recorder's thread."""

    def add(self, topic: str, sample: Sample) -> None:
        """Add a message."""
        ...

    def write_due(self, now: float) -> None:
        """Write what is due at `now` (monotonic clock)."""
        ...

    def close(self) -> None:
        """Write everything and close."""
        ...


class Arrival(NamedTuple):
    """A message of a topic, and the sinks to write it to."""

    topic: str
    sample: Sample
    sinks: tuple[Sink, ...]


_Work: TypeAlias = "Sequence[Arrival] | Callable[[], None] | None"


class Recorder:
    """The one thread for all recordings. `put` and `run` are called on the event loop and never wait."""

    def __init__(self) -> None:
        self.dropped: Counter[str] = Counter()
        """Messages dropped because the queue was full, by topic."""
        self._queue: queue.SimpleQueue[_Work] = queue.SimpleQueue()
        self._queued_bytes = 0
        self._processed_bytes = 0
        self._sinks: list[Sink] = []
        self._thread: threading.Thread | None = None

    def start(self) -> None:
        """Start the thread."""
        self._thread = threading.Thread(target=self._work, name="rosld-recorder", daemon=True)
        self._thread.start()

    @property
    def queued_bytes(self) -> int:
        """Bytes of the messages that wait to be written."""
        return self._queued_bytes - self._processed_bytes

    def put(self, arrivals: Sequence[Arrival]) -> None:
        """Queue messages for writing; drop and count those that do not fit."""
        room = MAX_QUEUED - self.queued_bytes
        accepted: list[Arrival] = []
        for each in arrivals:
            size = len(each.sample.data) + SAMPLE_OVERHEAD
            if size > room:
                self.dropped[each.topic] += 1
                continue
            room -= size
            self._queued_bytes += size
            accepted.append(each)
        if accepted:
            self._queue.put(accepted)

    def run(self, work: Callable[[], None]) -> None:
        """Run a function on the thread, after the messages queued before."""
        self._queue.put(work)

    def add_sink(self, sink: Sink) -> None:
        """Add a sink, whose due chunks are written periodically. Called on the thread, or before it is started."""
        self._sinks.append(sink)

    def remove_sink(self, sink: Sink) -> None:
        """Stop writing to a sink. Runs on the thread."""
        self._sinks = [each for each in self._sinks if each is not sink]

    def stop(self) -> None:
        """Write all queued messages, end the thread, and wait for its end. Idempotent."""
        thread, self._thread = self._thread, None
        if thread is not None:
            self._queue.put(None)
            thread.join()

    def _work(self) -> None:
        written = time.monotonic()
        while True:
            try:
                work = self._queue.get(timeout=_PERIOD)
                if work is None:
                    break
                self._process(work)
            except queue.Empty:
                pass
            except Exception:  # a failure of one message or recording must not end the others
                log.exception("messages could not be recorded")
            now = time.monotonic()
            if now - written >= _PERIOD:
                written = now
                self._for_each_sink(lambda sink: sink.write_due(time.monotonic()))
        self._for_each_sink(lambda sink: sink.close())

    def _process(self, work: Sequence[Arrival] | Callable[[], None]) -> None:
        if callable(work):
            work()
            return
        for topic, sample, sinks in work:
            self._processed_bytes += len(sample.data) + SAMPLE_OVERHEAD
            for sink in sinks:
                sink.add(topic, sample)

    def _for_each_sink(self, action: Callable[[Sink], None]) -> None:
        for sink in list(self._sinks):
            try:
                action(sink)
            except Exception:  # see above
                log.exception("a recording could not be written")


class LatchedMessages:
    """The latest latched message of each publisher of each topic. Changed by one thread, read by any.

    Of transforms, the latest few messages are stored, because later ones add frames to earlier ones.
    """

    def __init__(self) -> None:
        self._samples: dict[tuple[str, str], tuple[Sample, ...]] = {}

    def take(self, topic: str, sample: Sample) -> None:
        """Add the newest message of its publisher; ignore it if it is not latched."""
        if sample.latched:
            key = topic, sample.publisher
            self._samples[key] = (*self._samples.get(key, ()), sample)[-latched_depth(sample.schema.name) :]

    def keep(self, is_there: Callable[[str, str], bool]) -> None:
        """Remove the messages of publishers that no longer exist, by topic and name."""
        self._samples = {key: samples for key, samples in list(self._samples.items()) if is_there(*key)}

    def messages(self, selects: Callable[[str], bool]) -> list[tuple[str, Sample]]:
        """Return the messages of wanted topics, in the order of receipt."""
        selected = [
            (topic, sample)
            for (topic, _), samples in list(self._samples.items())
            if samples and selects(topic)
            for sample in samples
        ]
        return sorted(selected, key=lambda one: one[1].received_ns)
