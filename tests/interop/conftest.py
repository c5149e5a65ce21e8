"""Third-party clients in their default configuration, each with a real rosld over real HTTP.

`make interop` runs this folder and `make test` omits it. Tests whose dependencies are missing are skipped with their
names; with CI=true they fail.
"""

from __future__ import annotations

import itertools
import subprocess
from collections.abc import Callable
from typing import Any

import pytest

from tests.interop.missing import require
from tests.server.conftest import start_server, triples_of

__all__ = ["start_server", "triples_of"]
"""Fixtures from the tests of the server: one starts servers, one reads responses."""

PATIENCE = 60.0
_COUNTER = itertools.count(1)


@pytest.fixture(scope="module")
def server(start_server: Callable[..., Any]) -> Any:
    """A server of the embedded aircraft, shared by all clients: `url` is its entry, `http` an HTTP client for it."""
    return start_server("aircraft", "--max-publish-rate", "100000")


@pytest.fixture
def folder(server: Any) -> str:
    """The URL of a container for one test below `/data/`, which a client's first write creates."""
    return f"{server.url}data/t{next(_COUNTER)}/"


@pytest.fixture(scope="session")
def curl() -> Callable[..., str]:
    """Return the output of curl."""
    require("curl")

    def run(*arguments: str, given: str | None = None) -> str:
        command = ["curl", "-sS", "-g", *arguments]
        done = subprocess.run(command, input=given, capture_output=True, text=True, timeout=PATIENCE, check=False)
        assert done.returncode == 0, done.stderr
        return done.stdout

    return run
