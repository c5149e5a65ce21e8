"""Fixtures: an embedded rover per file, and one for a single test with another initial state."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any, TypeAlias

import pytest

from tests.rover.rovers import Rover, running
from tests.server.conftest import serve, start_server

__all__ = ["serve", "start_server"]
"""Fixtures that start servers, from the tests of the server."""

StartRover: TypeAlias = "Callable[..., Rover]"


@pytest.fixture(scope="module")
def rover(start_server: Callable[..., Any]) -> Iterator[Rover]:
    """The embedded rover, shared by the tests of a file, each of which leaves it at rest, in any place."""
    with running("embedded", start_server, Path()) as found:
        yield found


@pytest.fixture
def start_rover(serve: Callable[..., Any]) -> Iterator[StartRover]:
    """Start an embedded rover for one test: `start_rover("battery=0.21&rate=10", "--max-publish-rate", "1000")`."""
    with ExitStack() as ending:
        yield lambda *given: ending.enter_context(running("embedded", serve, Path(), *given))
