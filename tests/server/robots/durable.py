"""The aircraft with a data folder, served repeatedly."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import httpx

from tests.serving_thread import ServingThread


@contextmanager
def running(folder: Path, port: int) -> Iterator[httpx.Client]:
    """Run a server on a data folder, always at the port in the folder's URLs."""
    server = ServingThread.of_command("aircraft", "--data", str(folder), "--port", str(port))
    try:
        with httpx.Client(base_url=server.url(), timeout=15) as client:
            yield client
    finally:
        server.send_signal(signal.SIGTERM)
        assert server.wait(60) == 0
