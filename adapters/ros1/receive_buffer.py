"""The kernel's receive buffer of a connection to a publisher, sized by what comes in.

A publisher without a queue (rospy's `queue_size=None`) waits in `publish()` as soon as the buffers between it and a
subscriber are full, so they must hold what it sends while this process does not run.
"""

from __future__ import annotations

import socket
import sys
from pathlib import Path

SECONDS = 2.0
"""How much of a topic the buffer holds, by the highest rate seen: a second is promised, measured rates vary."""
MIN_BYTES = 1024 * 1024
MAX_BYTES = 64 * 1024 * 1024
_PERMITTED = Path("/proc/sys/net/core/rmem_max")
_FORCE = 33 if sys.platform == "linux" else None
"""SO_RCVBUFFORCE, which `socket` does not name: beyond net.core.rmem_max, for those who may (CAP_NET_ADMIN)."""


def wanted_bytes(highest_rate: float) -> int:
    """The bytes that a buffer should hold for a topic of so many bytes a second."""
    return min(max(int(SECONDS * highest_rate), MIN_BYTES), MAX_BYTES)


class ReceiveBuffer:
    """Enlarges the receive buffer of one socket; never makes it smaller than the system's own tuning did."""

    def __init__(self, sock: socket.socket, now: float) -> None:
        self._socket = sock
        self._seen = (now, 0)
        self._highest = 0.0
        self._asked = 0

    def fit(self, received: int, now: float) -> None:
        """Heed that `received` bytes have come so far, at `now` (seconds); called about once a second."""
        then, before = self._seen
        if now - then < 0.5:
            return
        self._seen = (now, received)
        self._highest = max(self._highest, (received - before) / (now - then))
        wanted = wanted_bytes(self._highest)
        if wanted > self._asked:
            self._asked = max(wanted, self._asked * 5 // 4)  # rates waver: not a call for each time
            enlarge(self._socket, self._asked)


def enlarge(sock: socket.socket, size: int) -> None:
    """Have the kernel hold `size` bytes, or as many as it permits, where that is more than now.

    The kernel doubles the number for its own bookkeeping, and tells the doubled one.
    """
    try:
        if 2 * size <= sock.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF):
            return
        if _FORCE is not None:
            try:
                sock.setsockopt(socket.SOL_SOCKET, _FORCE, size)
                return
            except PermissionError:
                size = min(size, max_permitted_bytes())
        if 2 * size > sock.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF):
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, size)
    except OSError:
        pass  # the connection has just ended


def max_permitted_bytes() -> int:
    """The largest buffer that anybody may ask for (net.core.rmem_max), in bytes; `MAX_BYTES` where that is not told."""
    try:
        return int(_PERMITTED.read_text())
    except (OSError, ValueError):
        return MAX_BYTES
