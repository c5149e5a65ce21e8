"""Fixtures: each rover in turn, and one of a test's own that begins in another way."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from typing import Any, TypeAlias

import pytest

from tests.rover.rovers import ROVERS, Rover, running
from tests.server.conftest import serve, start_lasting_server, start_server

__all__ = ["serve", "start_lasting_server", "start_server"]
"""The fixtures that start servers; they belong to the server's tests."""

StartRover: TypeAlias = "Callable[..., Rover]"
EACH = [pytest.param(name, marks=[pytest.mark.ros2] if name == "kilted" else []) for name in ROVERS]


@pytest.fixture(scope="session", params=EACH)
def rover(
    request: pytest.FixtureRequest, start_lasting_server: Callable[..., Any], tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Rover]:
    """Each rover in turn, for all tests: each leaves it standing, and none may count on where."""
    with running(request.param, start_lasting_server, tmp_path_factory.mktemp(request.param)) as found:
        yield found


@pytest.fixture(scope="module", params=EACH)
def stranded(
    request: pytest.FixtureRequest, start_server: Callable[..., Any], tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Rover]:
    """A rover of each kind at its start, with an empty battery."""
    with running(request.param, start_server, tmp_path_factory.mktemp(request.param), "battery=0") as found:
        yield found


@pytest.fixture(params=EACH)
def start_rover(
    request: pytest.FixtureRequest, serve: Callable[..., Any], tmp_path_factory: pytest.TempPathFactory
) -> Iterator[StartRover]:
    """Starts a rover of each kind for one test: `start_rover("battery=0.21&rate=10", "--max-publish-rate", "1000")`."""
    with ExitStack() as ending:

        def started(begins: str = "", *arguments: str) -> Rover:
            folder = tmp_path_factory.mktemp(request.param)
            return ending.enter_context(running(request.param, serve, folder, begins, *arguments))

        yield started
