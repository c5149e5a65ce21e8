"""Thread that waits for the middleware and notifies readers, without taking messages itself.

A handle is armed for a single notification, so that many messages cost one wake-up, and unwatched topics nothing.
"""

from __future__ import annotations

import asyncio
import importlib
import threading
from collections.abc import Callable, Sequence
from contextlib import ExitStack, suppress
from functools import partial
from typing import Any, Literal

from rosld.adapters.ros2.middleware import Handle, Participant, invalid_handle

_AT_MOST = 1.0


class Waiter:
    """Waits in a separate thread. `arm` and `disarm` are thread-safe."""

    def __init__(self, participant: Participant) -> None:
        self._context = participant.context
        guard = importlib.import_module("rclpy.guard_condition").GuardCondition
        self._guard = guard(None, None, context=self._context)
        self._room = (0, 0)
        self._set: Any = None
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
        self._wake()

    def disarm(self, handle: Handle) -> None:
        """Stop notifications about a handle."""
        with self._lock:
            removed = self._armed.pop(id(handle), None)
        if removed is not None:
            self._wake()

    def stop(self, timeout: float) -> None:
        """End the thread; wait at most `timeout` seconds."""
        self._stopping = True
        self._wake()
        if self._thread.is_alive():
            self._thread.join(timeout)
        self._guard.destroy()

    def _wake(self) -> None:
        with suppress(invalid_handle()):  # nobody is waiting any more
            self._guard.trigger()

    def _wait_for(self, readers: Sequence[Handle], clients: Sequence[Handle]) -> set[int]:
        """Return the pointers of the handles that are ready. The handles must be entered."""
        room = (_room(len(readers)), _room(len(clients)))
        if self._set is None or room != self._room:
            rclpy = importlib.import_module("rclpy.impl.implementation_singleton").rclpy_implementation
            self._set = rclpy.WaitSet(room[0], 1, 0, room[1], 0, 0, self._context.handle)
            self._room = room
        self._set.clear_entities()
        for reader in readers:
            self._set.add_subscription(reader)
        for client in clients:
            self._set.add_client(client)
        self._set.add_guard_condition(self._guard.handle)
        self._set.wait(int(_AT_MOST * 1e9))
        ready = self._set.get_ready_entities
        return {*(ready("subscription") if readers else ()), *(ready("client") if clients else ())}

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
                stack.enter_context(self._guard.handle)
                readers = [handle for key, handle in entered.items() if armed[key][1] == "reader"]
                clients = [handle for key, handle in entered.items() if armed[key][1] == "client"]
                ready = self._wait_for(readers, clients)
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


def _room(count: int) -> int:
    """Return a capacity with some reserve, so that a wait set can be reused."""
    return 0 if count == 0 else 1 << (count - 1).bit_length()
