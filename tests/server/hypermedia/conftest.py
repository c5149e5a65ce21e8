"""Validation of JSON by JSON Schema, with Ajv and the W3C's own schema of Thing Descriptions."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Callable, Sequence
from pathlib import Path

import pytest

from tests.agents.node import node_modules

JUDGE = Path(__file__).with_name("judge.cjs")


@pytest.fixture(scope="session")
def judged() -> Callable[[Sequence[tuple[object, object]]], list[list[str]]]:
    """Return the errors for pairs of a schema (`"td"` for that of Thing Descriptions) and a value, in one batch."""
    packages = node_modules()

    def judge(pairs: Sequence[tuple[object, object]]) -> list[list[str]]:
        command = ["node", str(JUDGE), str(packages)]
        done = subprocess.run(command, input=json.dumps(pairs).encode(), capture_output=True, timeout=120, check=False)
        assert done.returncode == 0, done.stderr.decode()[-2000:]
        verdicts: list[list[str]] = json.loads(done.stdout)
        return verdicts

    return judge
