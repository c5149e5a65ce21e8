"""Validators of SHACL on the JVM, as commands: the report of each."""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from pathlib import Path

import rdflib

from tests.interop.java.maven import libraries

POM = Path(__file__).parent / "pom.xml"
PATIENCE = 300.0


def validate_by_topbraid(data: Path, shapes: Path) -> rdflib.Graph:
    """Return the report of TopBraid's `shaclvalidate`."""
    return _report("org.topbraid.shacl.tools.Validate", "-datafile", data, "-shapesfile", shapes)


def validate_by_jena(data: Path, shapes: Path) -> rdflib.Graph:
    """Return the report of Jena's `shacl validate`."""
    return _report("shacl.shacl", "validate", "--shapes", shapes, "--data", data)


VALIDATORS: dict[str, Callable[[Path, Path], rdflib.Graph]] = {
    "TopBraid": validate_by_topbraid,
    "Jena": validate_by_jena,
}


def _report(*command: str | Path) -> rdflib.Graph:
    """Return the validation report that a command prints."""
    java = ["java", "-XX:+UseSerialGC", "-cp", f"{libraries(POM)}/*"]
    done = subprocess.run([*java, *map(str, command)], capture_output=True, text=True, timeout=PATIENCE, check=False)
    report = rdflib.Graph().parse(data=done.stdout, format="turtle")
    assert list(report.subjects(rdflib.SH.conforms)), done.stderr
    return report
