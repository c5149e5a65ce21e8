"""The aircraft with a folder of data, one server after the other."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import httpx

from tests.forked import ForkedCommand


@contextmanager
def running(folder: Path, port: int) -> Iterator[httpx.Client]:
    """A server on a folder of data, at the one port that the folder's URLs have."""
    process = ForkedCommand("serve", "aircraft", "--data", str(folder), "--port", str(port))
    try:
        with httpx.Client(base_url=process.stdout.readline().strip(), timeout=15) as client:
            yield client
    finally:
        process.send_signal(signal.SIGTERM)
        assert process.wait(60) == 0
