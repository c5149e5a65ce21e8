"""Folding: topics whose messages complete each other, such as `/tf`, shown as one message that holds them all.

A publisher of `/tf` sends some of its frames in one message and others in the next; the newest message alone would
hide the rest. The elements of such messages have a key (a transform its child frame, a diagnostic status its name),
and the newest element of each key stays.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import NamedTuple, cast

from rosld.adapters.model import Message, MessageSchema, Sample


class Fold(NamedTuple):
    """How messages of one type fold: which array holds the elements, and which of their fields is the key."""

    array: str
    key: str


FOLDS = {
    "tf2_msgs/msg/TFMessage": Fold("transforms", "child_frame_id"),
    "tf/msg/tfMessage": Fold("transforms", "child_frame_id"),
    "diagnostic_msgs/msg/DiagnosticArray": Fold("status", "name"),
}
QUEUE_DEPTH = 128
"""How many messages a publisher may send between two looks without one being lost; looks are made twice a second."""
MAX_KEYS = 10_000


class FoldedTopic:
    """The elements seen so far on one topic: the newest of each key, each in the message that brought it."""

    def __init__(self, fold: Fold) -> None:
        self._fold = fold
        self._elements: dict[str, tuple[Sample, object]] = {}
        self._seen: dict[str, tuple[int, int]] = {}
        self._last: tuple[Sample, Message] | None = None

    def take(self, samples: Iterable[Sample], decode: Callable[[Sample], Message]) -> bool:
        """Fold in the samples not seen before (oldest first); whether there was any. ValueError from `decode`."""
        changed = False
        for sample in samples:
            place = (sample.epoch, sample.sequence)
            if place <= self._seen.get(sample.publisher, (-1, -1)):
                continue
            self._seen[sample.publisher] = place
            self._add(sample, decode(sample))
            changed = True
        return changed

    def _add(self, sample: Sample, message: Message) -> None:
        for element in cast("list[object]", getattr(message, self._fold.array)):
            key = cast(str, getattr(element, self._fold.key))
            self._elements.pop(key, None)  # the newest goes last
            self._elements[key] = (sample, element)
        while len(self._elements) > MAX_KEYS:
            self._elements.pop(next(iter(self._elements)))
        self._last = (sample, message)

    def times(self) -> Mapping[str, int]:
        """When the newest element of each key was received, in nanoseconds."""
        return {key: sample.received_ns for key, (sample, _) in self._elements.items()}

    def sample(self, schema: MessageSchema) -> Sample | None:
        """The folded message as one sample, as new as the newest that it is made of."""
        if self._last is None:
            return None
        newest, message = self._last
        values = {field.attribute: getattr(message, field.attribute) for field in schema.type.fields}
        values[self._fold.array] = [self._elements[key][1] for key in sorted(self._elements)]
        whole = schema.codec.build(schema.ref.name, values)
        return newest._replace(data=schema.codec.encode(whole, newest.encoding))


def decoder_of(schema: MessageSchema) -> Callable[[Sample], Message]:
    """Decodes samples of one schema."""
    codec = schema.codec

    def decode(sample: Sample) -> Message:
        return codec.decode(sample.data, sample.encoding)

    return decode
