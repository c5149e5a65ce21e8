"""Slots: the newest samples of each publisher of one topic, and the watches of those who wait for more.

For adapters whose samples arrive on the server's loop. Nothing here is thread-safe, and nothing costs more than a
few microseconds: a sample that nobody looks at replaces one entry.
"""

from __future__ import annotations

import asyncio
from collections import Counter, deque
from collections.abc import Callable, Sequence

from rosld.adapters.base import Watch
from rosld.adapters.model import Sample


class Watches:
    """Watches to wake on the running loop when something new arrives, at most once per iteration each."""

    def __init__(self) -> None:
        self._watches: dict[LoopWatch, None] = {}

    def __len__(self) -> int:
        return len(self._watches)

    def add(self, wake: Callable[[], None]) -> LoopWatch:
        """Wake from now on, until the watch is closed. To be called on the loop."""
        watch = LoopWatch(wake, self._watches)
        self._watches[watch] = None
        return watch

    def notify(self) -> None:
        """Something new is there."""
        for watch in self._watches:
            watch.notify()


class LoopWatch:
    """One running watch: coalesces what arrives in one turn of the loop into one wake."""

    def __init__(self, wake: Callable[[], None], among: dict[LoopWatch, None]) -> None:
        self._wake: Callable[[], None] | None = wake
        self._among = among
        self._loop = asyncio.get_running_loop()
        self._due = False

    def notify(self) -> None:
        """Wake in the next turn of the loop."""
        if not self._due:
            self._due = True
            self._loop.call_soon(self._run)

    def _run(self) -> None:
        self._due = False
        if self._wake is not None:
            self._wake()

    def close(self) -> None:
        """Stop waking, one that is already due included. Idempotent."""
        self._wake = None
        self._among.pop(self, None)


class Slot:
    """The newest samples of each publisher of one topic."""

    def __init__(self) -> None:
        self.watches = Watches()
        self.subscriptions = 0
        self._depth = 1
        self._depths: Counter[int] = Counter()
        self._samples: dict[str, deque[Sample]] = {}
        self._views: dict[int, tuple[Sample, ...]] = {}

    def put(self, sample: Sample) -> None:
        """Keep a sample as its publisher's newest."""
        samples = self._samples.get(sample.publisher)
        if samples is None:
            samples = self._samples[sample.publisher] = deque(maxlen=self._depth)
        samples.append(sample)
        self._on_change()

    def drop(self, publisher: str) -> None:
        """Forget what a publisher sent; nothing happens where it sent nothing."""
        if self._samples.pop(publisher, None) is not None:
            self._on_change()

    def latest(self, depth: int = 1) -> Sequence[Sample]:
        """The newest `depth` samples of each publisher in order of receipt; the same object until one arrives."""
        view = self._views.get(depth)
        if view is None:
            newest = [sample for samples in self._samples.values() for sample in tuple(samples)[-depth:]]
            view = self._views[depth] = tuple(sorted(newest, key=_received_ns))
        return view

    def subscribe(self, depth: int = 1) -> SlotSubscription:
        """Have at least `depth` samples of each publisher kept until what is returned is closed.

        Raises ValueError for a depth below 1.
        """
        if depth < 1:
            raise ValueError(f"a depth of {depth} holds no sample: it must be 1 or more")
        self._depths[depth] += 1
        self._fit()
        return SlotSubscription(self, depth)

    def release(self, depth: int) -> None:
        """One interest less. To be called by the subscription."""
        self._depths[depth] -= 1
        if not self._depths[depth]:
            del self._depths[depth]
        self._fit()

    def _fit(self) -> None:
        """Keep as many as the deepest subscription needs."""
        depth = max(self._depths, default=1)
        if depth != self._depth:
            self._depth = depth
            self._samples = {publisher: deque(samples, maxlen=depth) for publisher, samples in self._samples.items()}
            self._views.clear()

    def _on_change(self) -> None:
        self._views.clear()
        self.watches.notify()


def _received_ns(sample: Sample) -> int:
    return sample.received_ns


class SlotSubscription:
    """Subscription to one slot. After `close` it is empty and wakes nothing."""

    def __init__(self, slot: Slot, depth: int) -> None:
        self._slot: Slot | None = slot
        self._depth = depth
        self._watches: list[LoopWatch] = []
        slot.subscriptions += 1

    def latest(self) -> Sequence[Sample]:
        """Return the newest samples of each publisher, in order of receipt."""
        return () if self._slot is None else self._slot.latest(self._depth)

    def watch(self, wake: Callable[[], None]) -> Watch:
        """Wake on the loop after something new arrived; ends with the subscription."""
        if self._slot is None:
            return LoopWatch(wake, {})
        watch = self._slot.watches.add(wake)
        self._watches.append(watch)
        return watch

    def close(self) -> None:
        """Give this interest back. Idempotent."""
        if self._slot is not None:
            self._slot.subscriptions -= 1
            self._slot.release(self._depth)
            self._slot = None
            for watch in self._watches:
                watch.close()
