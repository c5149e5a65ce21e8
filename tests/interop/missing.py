"""Dependencies of clients: tests are skipped by name if they are missing, and fail with CI=true."""

from __future__ import annotations

import os
import shutil
from pathlib import Path
from typing import NoReturn

import pytest

DEBIAN = Path(__file__).parent / "debian.txt"


def missing(reason: str) -> NoReturn:
    """Skip the test with the name of the missing dependency; fail instead under CI."""
    if os.environ.get("CI", "").lower() == "true":
        pytest.fail(reason)
    pytest.skip(reason)


def require(*commands: str, path: str | None = None) -> None:
    """Skip the test if a command from Debian is not installed."""
    for command in commands:
        if shutil.which(command, path=path) is None:
            missing(
                f"there is no {command}: apt-get install --no-install-recommends {' '.join(DEBIAN.read_text().split())}"
            )
