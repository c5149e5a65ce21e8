"""Watches: notification that something may have changed, without a payload; it may be spurious."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

from rosld.adapters.base import Watch


class Signal:
    """Wakes its watches whenever it is emitted; to be used on the server's loop."""

    def __init__(self) -> None:
        self._watches: dict[_SignalWatch, None] = {}

    def watch(self, wake: Callable[[], None], concerns: Callable[[str], bool] | None = None) -> Watch:
        """Call `wake` whenever the signal is given, or only when `concerns` says so of what it is about."""
        watch = _SignalWatch(wake, concerns, self._watches)
        self._watches[watch] = None
        return watch

    def emit(self, about: str = "") -> None:
        """Wake those whom it concerns."""
        for watch in tuple(self._watches):
            watch.take(about)


class _SignalWatch:
    """A watch of a signal, for what `concerns` says; None: for everything."""

    def __init__(
        self, wake: Callable[[], None], concerns: Callable[[str], bool] | None, among: dict[_SignalWatch, None]
    ) -> None:
        self._wake = wake
        self._concerns = concerns
        self._among = among

    def take(self, about: str) -> None:
        if self in self._among and (self._concerns is None or self._concerns(about)):
            self._wake()

    def close(self) -> None:
        """Stop waking. Idempotent."""
        self._among.pop(self, None)


class _Every:
    """A watch that wakes at intervals, for what can only be polled."""

    def __init__(self, seconds: float, wake: Callable[[], None]) -> None:
        self._loop = asyncio.get_running_loop()
        self._seconds = seconds
        self._wake = wake
        self._timer = self._loop.call_later(seconds, self._ring)

    def _ring(self) -> None:
        self._timer = self._loop.call_later(self._seconds, self._ring)
        self._wake()

    def close(self) -> None:
        """Stop waking. Idempotent."""
        self._timer.cancel()


class _Together:
    """Several watches as one."""

    def __init__(self, watches: tuple[Watch, ...]) -> None:
        self._watches = watches

    def close(self) -> None:
        """Stop waking. Idempotent."""
        for watch in self._watches:
            watch.close()


def call_every(seconds: float, wake: Callable[[], None]) -> Watch:
    """Call `wake` every so many seconds."""
    return _Every(seconds, wake)


def combine_watches(*watches: Watch) -> Watch:
    """Several watches as one: for a resource that is made of several things."""
    return _Together(watches)
