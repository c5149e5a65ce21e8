"""The workflows of GitHub, checked by actionlint."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

from tests.interop.missing import require

ROOT = Path(__file__).parent.parent.parent
ACTIONLINT = "github.com/rhysd/actionlint/cmd/actionlint@v1.7.12"


def test_actionlint_finds_nothing_wrong_with_the_workflows() -> None:
    path = os.pathsep.join([os.environ["PATH"], str(Path(sys.executable).parent)])
    require("go", path=path)
    found = subprocess.run(
        ["go", "run", ACTIONLINT],
        cwd=ROOT,
        env={**os.environ, "PATH": path},
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert found.returncode == 0, found.stdout + found.stderr
