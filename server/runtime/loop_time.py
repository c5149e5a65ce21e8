"""The clock of deadlines."""

from __future__ import annotations

import time

loop_time = time.monotonic
"""What `loop.time()` returns, of asyncio's loops and of uvloop's alike.

To ask for the running loop is a system call before Python 3.12, and a request would do so many times.
"""
