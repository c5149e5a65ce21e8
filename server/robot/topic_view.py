"""What is known of a topic's values at one moment, as an immutable value."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from rosld.adapters.model import Sample


@dataclass(frozen=True, slots=True)
class TopicView:
    """The samples of a topic as of one look: the newest of each publisher, and how often they come.

    `samples` is in order of receipt, the newest last; of a folded topic (`/tf`) it is one, made of all that came.
    `rate` is in messages a second over all publishers, None until measured. `times` tells of a folded topic when the
    newest element of each key was received, in nanoseconds.
    """

    samples: tuple[Sample, ...] = ()
    rate: float | None = None
    times: Mapping[str, int] = field(default_factory=dict)

    @property
    def newest(self) -> Sample | None:
        """The newest sample of all."""
        return self.samples[-1] if self.samples else None

    def version_key(self) -> str:
        """A short text that differs whenever samples or rate do."""
        digest = hashlib.blake2b(digest_size=9)
        for sample in self.samples:
            digest.update(f"{sample.publisher}\0{sample.epoch}\0{sample.sequence}\0{sample.received_ns}\0".encode())
        digest.update(repr(self.rate).encode("ascii"))
        return digest.hexdigest()


EMPTY_VIEW = TopicView()
"""Nothing was seen."""


@dataclass(slots=True)
class _Anchor:
    """Where counting began for one publisher, and a younger place to begin anew from."""

    epoch: int
    sequence: int
    received_ns: int
    next_sequence: int
    next_ns: int


_SPAN_NS = 5_000_000_000
"""Rates are means over the last five to ten seconds, as `rostopic hz` shows them."""
_LEAST_NS = 200_000_000
"""The least time between two messages that a rate is measured by: of less, the jitter of the network is the most."""


@dataclass(slots=True)
class RateEstimator:
    """Message rates, computed from sequence numbers as samples are taken: nothing is done per message."""

    _anchors: dict[str, _Anchor] = field(default_factory=dict)
    _rates: dict[str, float] = field(default_factory=dict)

    def observe(self, samples: Sequence[Sample]) -> float | None:
        """The rate over all publishers in messages a second after seeing these newest samples; None until measured."""
        for sample in samples:
            self._observe(sample)
        gone = self._anchors.keys() - {sample.publisher for sample in samples}
        for publisher in gone:
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
