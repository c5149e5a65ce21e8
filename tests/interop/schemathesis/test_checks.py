"""schemathesis from its command line, over all of /openapi.json, with all of its checks."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

CONFIG = Path(__file__).with_name("schemathesis.toml")
ENVIRONMENT = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[3])}  # folder of the module of hooks
PATIENCE = 400.0
ALIKE = r"^/queries/(?!graph$|node$|silent-topics$)[a-z]"
"""Stored queries whose descriptions and answers are like those of others."""


def test_schemathesis_finds_no_fault(start_server: Callable[..., Any], tmp_path: Path) -> None:
    """It has its own server, as its requests stop the robot, among other things."""
    served = start_server("aircraft", "--max-publish-rate", "100000")
    command = [sys.executable, "-m", "schemathesis.cli", "--no-color", "--config-file", str(CONFIG)]
    command += ["run", f"{served.url}openapi.json", "--continue-on-failure", "--warnings", "off"]
    command += ["--exclude-path-regex", ALIKE]
    done = subprocess.run(
        command, cwd=tmp_path, env=ENVIRONMENT, capture_output=True, text=True, timeout=PATIENCE, check=False
    )
    assert done.returncode == 0, done.stdout[-20_000:] + done.stderr[-2000:]
    assert served.process.poll() is None, "the server died"
