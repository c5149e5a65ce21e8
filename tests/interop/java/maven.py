"""Java for tests: the libraries of pom.xml, fetched once into `target/lib`, and the sources of `src`, compiled once.

Maven's own configuration determines the repository. Only `dependency:copy-dependencies` of its build is run.
"""

from __future__ import annotations

import subprocess
from collections.abc import Sequence
from pathlib import Path

from tests.interop.missing import missing, require
from tests.interop.stamps import made_once

HERE = Path(__file__).parent
POM, SOURCES = HERE / "pom.xml", sorted((HERE / "src").glob("*.java"))
CLASSES = HERE / "target" / "classes"
CLASS_PATH = f"{HERE / 'target' / 'lib'}/*"
COPY = "org.apache.maven.plugins:maven-dependency-plugin:3.8.1:copy-dependencies"
PATIENCE = 300.0


def java(*arguments: str) -> Sequence[str]:
    """Return the command that runs one of the classes, which are compiled first if necessary."""
    require("javac")
    libraries(POM)
    with made_once(CLASSES, [POM, *SOURCES]) as are_here:
        if not are_here:
            _compile()
    return ["java", "-XX:+UseSerialGC", "-cp", f"{CLASS_PATH}:{CLASSES}", *arguments]


def libraries(pom: Path) -> Path:
    """Return the folder of the libraries of a pom, which are fetched first if necessary."""
    require("java", "mvn")
    folder = pom.parent / "target" / "lib"
    with made_once(folder, [pom]) as are_here:
        if not are_here:
            _fetch(pom, folder)
    return folder


def _fetch(pom: Path, folder: Path) -> None:
    command = ("mvn", "--batch-mode", "--quiet", COPY, "-DincludeTypes=jar", f"-DoutputDirectory={folder}")
    done = subprocess.run(command, cwd=pom.parent, capture_output=True, text=True, timeout=PATIENCE, check=False)
    if done.returncode != 0:
        missing(f"the libraries of {pom} could not be fetched: {done.stdout[-1500:]}{done.stderr[-500:]}")


def _compile() -> None:
    command = ("javac", "-encoding", "UTF-8", "-cp", CLASS_PATH, "-d", str(CLASSES), *map(str, SOURCES))
    done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE, check=False)
    assert done.returncode == 0, done.stderr
