"""Fixtures: the embedded rover of a file, and one of a test's own that begins in another way."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any, TypeAlias

import pytest

from tests.rover.rovers import Rover, running
from tests.server.conftest import serve, start_server

__all__ = ["serve", "start_server"]
"""The fixtures that start servers; they belong to the server's tests."""

StartRover: TypeAlias = "Callable[..., Rover]"


@pytest.fixture(scope="module")
def rover(start_server: Callable[..., Any]) -> Iterator[Rover]:
    """The embedded rover, shared by the tests of a file: each leaves it standing, wherever that is."""
    with running("embedded", start_server, Path()) as found:
        yield found


@pytest.fixture
def start_rover(serve: Callable[..., Any]) -> Iterator[StartRover]:
    """Starts an embedded rover for one test: `start_rover("battery=0.21&rate=10", "--max-publish-rate", "1000")`."""
    with ExitStack() as ending:
        yield lambda *given: ending.enter_context(running("embedded", serve, Path(), *given))
