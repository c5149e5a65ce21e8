"""Judging JSON by JSON Schema, with Ajv and the W3C's own schema of Thing Descriptions."""

from __future__ import annotations

import importlib.util
import json
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from types import ModuleType

import pytest

JUDGE = Path(__file__).with_name("judge.cjs")
NODE = Path(__file__).parents[2] / "agents" / "node.py"


def node_tools() -> ModuleType:
    """`tests/agents/node.py` as a module: test folders are no packages, so it is loaded from its file."""
    name = "rosld_node_for_tests"
    if name not in sys.modules:
        spec = importlib.util.spec_from_file_location(name, NODE)
        assert spec is not None
        assert spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        sys.modules[name] = module
        spec.loader.exec_module(module)
    return sys.modules[name]


@pytest.fixture(scope="session")
def judged() -> Callable[[Sequence[tuple[object, object]]], list[list[str]]]:
    """Pairs of a schema (`"td"`: that of Thing Descriptions) and a value, to the errors of each, in one go."""
    packages: Path = node_tools().node_modules()

    def judge(pairs: Sequence[tuple[object, object]]) -> list[list[str]]:
        command = ["node", str(JUDGE), str(packages)]
        done = subprocess.run(command, input=json.dumps(pairs).encode(), capture_output=True, timeout=120, check=False)
        assert done.returncode == 0, done.stderr.decode()[-2000:]
        verdicts: list[list[str]] = json.loads(done.stdout)
        return verdicts

    return judge
