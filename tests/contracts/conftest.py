"""The robots of the contract suite: one session-wide system a kind of adapter.

Each module in `ROBOTS` lies beside this file. It has a context manager `robot(folder: Path) -> Iterator[Robot]`, and
`HAS`, which names the attributes of `Robot` that are not None there ("read_only" where nothing can be written): tests
marked `@needs(...)` run only on robots that have what they need. A new adapter joins the suite with one such module
and one line here.
"""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

ROBOTS = ["aircraft", "recording", "ros1"]


def load(path: Path) -> ModuleType:
    """A module of the tests by its path: they are no package, so that nothing of theirs can be imported by name."""
    name = f"rosld_tests_{path.parent.name}_{path.stem}"
    if name not in sys.modules:
        spec = importlib.util.spec_from_file_location(name, path)
        assert spec is not None
        assert spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        sys.modules[name] = module
        spec.loader.exec_module(module)
    return sys.modules[name]


_HERE = Path(__file__).parent
load(_HERE / "robot.py")
load(_HERE.parent / "adapters" / "recording" / "recorder.py")
load(_HERE.parent / "adapters" / "ros1" / "system.py")
_MODULES = {name: load(_HERE / f"{name}.py") for name in ROBOTS}


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """Run a test on every robot that has what it needs."""
    if "robot" in metafunc.fixturenames:
        needed = frozenset(getattr(metafunc.function, "needed", ()))
        able = [name for name, module in _MODULES.items() if needed <= module.HAS]
        metafunc.parametrize("robot", able, indirect=True, scope="session")


@pytest.fixture(scope="session")
def robot(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    """A running system, as `robot.py` describes it."""
    with _MODULES[request.param].robot(tmp_path_factory.mktemp(request.param)) as running:
        yield running
