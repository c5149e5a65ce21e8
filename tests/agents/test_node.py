"""The packages for Node: named exactly, and installed once."""

from __future__ import annotations

import json
import re
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from subprocess import run

import pytest

HERE = Path(__file__).parent
CODE = "from tests.agents.node import node_modules; print(node_modules())"
WANTED: dict[str, str] = json.loads((HERE / "package.json").read_text())["dependencies"]


def test_packages_are_named_by_exact_versions() -> None:
    assert all(re.fullmatch(r"\d+\.\d+\.\d+(-[\w-]+)?", version) for version in WANTED.values()), WANTED


@pytest.mark.usefixtures("node")
def test_processes_that_ask_at_once_find_what_was_named() -> None:
    def ask(_: int) -> Path:
        done = run([sys.executable, "-c", CODE], cwd=HERE.parents[1], capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        return Path(done.stdout.strip())

    with ThreadPoolExecutor() as threads:
        (folder,) = set(threads.map(ask, range(2)))
    found = {name: json.loads((folder / name / "package.json").read_text())["version"] for name in WANTED}
    assert found == WANTED
