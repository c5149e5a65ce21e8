"""Views of topics: the newest samples of each publisher, their rate, and the folding of topics such as `/tf`.

A publisher of `/tf` sends some of its frames in one message and others in the next; the newest message alone would hide
the rest. The elements of such messages have a key (the child frame of a transform, the name of a diagnostic status),
and the newest element of each key is stored.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import NamedTuple, cast

from msgspec import Struct, field

from rosld.adapters.model import Message, MessageSchema, Sample


class Fold(NamedTuple):
    """Folding of messages of one type: the array of elements, and their key field."""

    array: str
    key: str


FOLDS = {
    "tf2_msgs/msg/TFMessage": Fold("transforms", "child_frame_id"),
    "tf/msg/tfMessage": Fold("transforms", "child_frame_id"),
    "diagnostic_msgs/msg/DiagnosticArray": Fold("status", "name"),
}
QUEUE_DEPTH = 128
"""Messages per publisher that are queued between two reads; reads happen at least twice a second."""
MAX_KEYS = 10_000


class FoldedTopic:
    """The elements received so far on one topic: the newest of each key, with its message."""

    def __init__(self, fold: Fold) -> None:
        self._fold = fold
        self._elements: dict[str, tuple[Sample, object]] = {}
        self._positions: dict[str, tuple[int, int]] = {}
        self._last: tuple[Sample, Message] | None = None

    def take(self, samples: Iterable[Sample], decode: Callable[[Sample], Message]) -> bool:
        """Fold in new samples (oldest first); return whether there were any. Raises ValueError from `decode`."""
        changed = False
        for sample in samples:
            position = (sample.epoch, sample.sequence)
            if position <= self._positions.get(sample.publisher, (-1, -1)):
                continue
            self._positions[sample.publisher] = position
            self._add(sample, decode(sample))
            changed = True
        return changed

    def _add(self, sample: Sample, message: Message) -> None:
        for element in cast("list[object]", getattr(message, self._fold.array)):
            key = cast(str, getattr(element, self._fold.key))
            self._elements.pop(key, None)  # moves the key to the end
            self._elements[key] = (sample, element)
        while len(self._elements) > MAX_KEYS:
            self._elements.pop(next(iter(self._elements)))
        self._last = (sample, message)

    def times(self) -> Mapping[str, int]:
        """Return the time of receipt of the newest element of each key, in nanoseconds."""
        return {key: sample.received_ns for key, (sample, _) in self._elements.items()}

    def sample(self, schema: MessageSchema) -> Sample | None:
        """Return the folded message as one sample, as new as its newest part."""
        if self._last is None:
            return None
        newest, message = self._last
        values = {field.attribute: getattr(message, field.attribute) for field in schema.type.fields}
        values[self._fold.array] = [self._elements[key][1] for key in sorted(self._elements)]
        whole = schema.codec.build(schema.ref.name, values)
        return newest._replace(data=schema.codec.encode(whole, newest.encoding))


def decoder_of(schema: MessageSchema) -> Callable[[Sample], Message]:
    """Return the decoder of samples of one schema."""
    codec = schema.codec

    def decode(sample: Sample) -> Message:
        return codec.decode(sample.data, sample.encoding)

    return decode


class TopicView(Struct, frozen=True):
    """The samples of a topic at one time: the newest of each publisher, and their rate.

    `samples` is in order of receipt, newest last; a folded topic (`/tf`) has a single one that combines all messages.
    `rate` is in messages per second over all publishers, None until measured. `times` are the times of receipt of the
    newest elements of a folded topic by key, in nanoseconds.
    """

    samples: tuple[Sample, ...] = ()
    rate: float | None = None
    times: Mapping[str, int] = field(default_factory=dict)

    @property
    def newest(self) -> Sample | None:
        """Newest sample of all publishers."""
        return self.samples[-1] if self.samples else None

    def version_key(self) -> str:
        """Return a short text that changes whenever samples or rate do."""
        digest = hashlib.blake2b(digest_size=9)
        for sample in self.samples:
            digest.update(f"{sample.publisher}\0{sample.epoch}\0{sample.sequence}\0{sample.received_ns}\0".encode())
        digest.update(repr(self.rate).encode("ascii"))
        return digest.hexdigest()


EMPTY_VIEW = TopicView()
"""View of a topic without messages."""


class _Anchor(Struct):
    """Start of the count for one publisher, and a later one to replace it."""

    epoch: int
    sequence: int
    received_ns: int
    next_sequence: int
    next_ns: int


_SPAN_NS = 5_000_000_000
"""Minimum time over which a rate is averaged (at most twice this), as `rostopic hz` shows it."""
_LEAST_NS = 200_000_000
"""Minimum time between two messages to measure a rate: below that, network jitter dominates."""


class RateEstimator(Struct):
    """Message rates, computed from sequence numbers when samples are read: there is no work per message."""

    _anchors: dict[str, _Anchor] = field(default_factory=dict)
    _rates: dict[str, float] = field(default_factory=dict)

    def observe(self, samples: Sequence[Sample]) -> float | None:
        """Return the rate over all publishers in messages per second after these samples; None until measured."""
        for sample in samples:
            self._observe(sample)
        departed = self._anchors.keys() - {sample.publisher for sample in samples}
        for publisher in departed:
            self._anchors.pop(publisher)
            self._rates.pop(publisher, None)
        return round(sum(self._rates.values()), 3) if self._rates else None

    def _observe(self, sample: Sample) -> None:
        anchor = self._anchors.get(sample.publisher)
        if anchor is None or sample.epoch != anchor.epoch or sample.sequence < anchor.sequence:
            self._anchors[sample.publisher] = _Anchor(
                sample.epoch, sample.sequence, sample.received_ns, sample.sequence, sample.received_ns
            )
            return
        elapsed = sample.received_ns - anchor.received_ns
        if elapsed < _LEAST_NS:
            return
        self._rates[sample.publisher] = (sample.sequence - anchor.sequence) * 1e9 / elapsed
        if elapsed > 2 * _SPAN_NS:
            anchor.sequence, anchor.received_ns = anchor.next_sequence, anchor.next_ns
        if sample.received_ns - anchor.next_ns > _SPAN_NS:
            anchor.next_sequence, anchor.next_ns = sample.sequence, sample.received_ns
