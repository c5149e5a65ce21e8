"""The aircraft with a folder of data, one server after the other."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import httpx

from tests.serving_thread import ServingThread


@contextmanager
def running(folder: Path, port: int) -> Iterator[httpx.Client]:
    """A server on a folder of data, at the one port that the folder's URLs have."""
    server = ServingThread.of_command("aircraft", "--data", str(folder), "--port", str(port))
    try:
        with httpx.Client(base_url=server.url(), timeout=15) as client:
            yield client
    finally:
        server.send_signal(signal.SIGTERM)
        assert server.wait(60) == 0
