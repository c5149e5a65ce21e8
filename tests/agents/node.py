"""Node for tests: the packages of package.json, installed once into `node_modules` next to this file.

npm's own configuration determines the registry, and `.npmrc` the installation. The W3C's JSON Schema of Thing
Descriptions is `node_modules() / "wot-thing-description-types/schema/td-json-schema-validation.json"`.
"""

from __future__ import annotations

import fcntl
import os
import shutil
import subprocess
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import NoReturn

import pytest

HERE = Path(__file__).parent
PACKAGE = HERE / "package.json"
FOLDER = HERE / "node_modules"
DEBIAN = HERE.parent / "debian-node.txt"
OLDEST = 18
PATIENCE = 300.0


def require_node() -> None:
    """Skip the test, with a hint what to install, without Node and npm; fail instead under CI."""
    if shutil.which("node") is None or shutil.which("npm") is None:
        _missing(f"no Node here: apt-get install --no-install-recommends {' '.join(DEBIAN.read_text().split())}")
    version = subprocess.run(["node", "--version"], capture_output=True, text=True, check=True).stdout.strip()
    if int(version.removeprefix("v").partition(".")[0]) < OLDEST:
        _missing(f"node is {version}, which is too old: install Node {OLDEST} or newer")


def node_modules() -> Path:
    """Return the folder of the packages, which are installed at first use and again when package.json changes."""
    require_node()
    FOLDER.mkdir(exist_ok=True)
    with _locked(FOLDER / ".lock"):
        wanted, stamp = PACKAGE.read_text(), FOLDER / ".installed"
        if not stamp.exists() or stamp.read_text() != wanted:
            stamp.unlink(missing_ok=True)
            command = ("npm", "install")
            done = subprocess.run(command, cwd=HERE, capture_output=True, text=True, timeout=PATIENCE, check=False)
            if done.returncode != 0:
                _missing(f"npm could not install {PACKAGE}: {done.stderr[-2000:]}")
            stamp.write_text(wanted)
    return FOLDER


def node(script: Path, *arguments: str) -> Sequence[str]:
    """Return the command that runs a script next to this file, with its packages installed."""
    node_modules()
    return ["node", str(script), *arguments]


@contextmanager
def _locked(path: Path) -> Iterator[None]:
    """Hold a lock between processes, which ends with the process in any case."""
    with path.open("w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield


def _missing(words: str) -> NoReturn:
    if os.environ.get("CI", "").lower() == "true":
        pytest.fail(words)
    pytest.skip(words)
