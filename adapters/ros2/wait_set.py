"""Thread that waits for the middleware and notifies readers, without taking messages itself.

A handle is armed for a single notification, so that many messages cost one wake-up, and unwatched topics nothing.
"""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable
from contextlib import ExitStack, suppress
from functools import partial
from typing import Literal

from rosld.adapters.ros2.middleware import Handle, Participant

_AT_MOST = 1.0


class Waiter:
    """Waits in a separate thread. `arm` and `disarm` are thread-safe."""

    def __init__(self, participant: Participant) -> None:
        self._wakeup = participant.wakeup()
        self._set = participant.wait_set()
        self._armed: dict[int, tuple[Handle, Literal["reader", "client"], Callable[[], None]]] = {}
        self._lock = threading.Lock()
        self._stopping = False
        self._thread = threading.Thread(target=self._run, name="rosld-ros2-wait", daemon=True)

    def start(self) -> None:
        self._thread.start()

    def arm(self, handle: Handle, kind: Literal["reader", "client"], ready: Callable[[], None]) -> None:
        """Call `ready` once, on the running event loop, when something can be taken."""
        with self._lock:
            self._armed[id(handle)] = handle, kind, partial(_call_soon, asyncio.get_running_loop(), ready)
        self._wakeup.trigger()

    def disarm(self, handle: Handle) -> None:
        """Stop notifications about a handle."""
        with self._lock:
            removed = self._armed.pop(id(handle), None)
        if removed is not None:
            self._wakeup.trigger()

    def stop(self, timeout: float) -> None:
        """End the thread; wait at most `timeout` seconds."""
        self._stopping = True
        self._wakeup.trigger()
        if self._thread.is_alive():
            self._thread.join(timeout)
        self._wakeup.close()

    def _run(self) -> None:
        while not self._stopping:
            for ready in self._wait():
                ready()

    def _wait(self) -> list[Callable[[], None]]:
        with self._lock:
            armed = dict(self._armed)
        with ExitStack() as stack:
            entered: dict[int, Handle] = {}
            for key, (handle, _, _) in armed.items():
                try:
                    stack.enter_context(handle)
                except Exception:  # the handle was destroyed
                    self._forget(key, handle)
                else:
                    entered[key] = handle
            try:
                stack.enter_context(self._wakeup.handle)
                readers = [handle for key, handle in entered.items() if armed[key][1] == "reader"]
                clients = [handle for key, handle in entered.items() if armed[key][1] == "client"]
                ready = self._set.wait(readers, clients, self._wakeup.handle, _AT_MOST)
            except Exception:  # the context was shut down
                self._stopping = True
                return []
            notified = [key for key, handle in entered.items() if handle.pointer in ready]
        return [armed[key][2] for key in notified if self._forget(key, armed[key][0])]

    def _forget(self, key: int, handle: Handle) -> bool:
        """Disarm a handle; return False if it was not armed."""
        with self._lock:
            found = self._armed.get(key)
            if found is None or found[0] is not handle:
                return False
            del self._armed[key]
            return True


def _call_soon(loop: asyncio.AbstractEventLoop, ready: Callable[[], None]) -> None:
    with suppress(RuntimeError):  # the loop has ended
        loop.call_soon_threadsafe(ready)
