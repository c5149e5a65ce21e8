"""Clients of one language, run in one process, which prints the result of each check as a line of JSON.

The names of the checks are read from the sources, so that each is a test, and one that was not run fails.
"""

from __future__ import annotations

import json
import re
import subprocess
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, TypeAlias

import pytest

Check: TypeAlias = tuple[str, str]
"""Name of the client, which is that of its source, and the description of the check."""

_DECLARED = re.compile(r'checks\.check\(\s*"([^"]+)"')


def declared(sources: Sequence[Path]) -> list[Any]:
    """Return the checks in the sources, for pytest."""
    found = [(path.stem, name) for path in sorted(sources) for name in _DECLARED.findall(path.read_text("utf-8"))]
    return [pytest.param(check, id="-".join(check)) for check in found]


def outcomes(command: Sequence[str], timeout: float) -> dict[Check, str | None]:
    """Run the process; return None or the error of each check. Results printed before a timeout count."""
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        try:
            output, errors = process.communicate(timeout=timeout)
        except subprocess.TimeoutExpired:
            process.kill()
            output, errors = process.communicate()
    lines = [json.loads(line) for line in output.splitlines() if line.startswith('{"client"')]
    assert lines, f"{command[0]} ended with {process.returncode}: {errors[-3000:]}"
    return {(line["client"], line["check"]): line["error"] for line in lines}


def judge(found: Mapping[Check, str | None], check: Check) -> None:
    """Fail with the error of a check."""
    assert check in found, "was not run: the process ended before"
    error = found[check]
    assert error is None, error
