"""Clients in Java: Jena, RDF4J, the JDK's HttpClient, Apache's. Each check of `src` is a test here."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pytest

from tests.interop.checks import Check, declared, judge, outcomes
from tests.interop.java.maven import SOURCES, java

PATIENCE = 300.0
AGAIN = "what was deleted cannot be made again yet"
CONTROL = "a pattern with U+0001 is not said in XML yet"
STORED = "a stored query has no TriG and no N-Quads yet"
PENDING: Mapping[Check, str] = {
    ("JenaGraphStore", "delete, then put"): AGAIN,
    ("JenaGraphStore", "delete, then load"): AGAIN,
    ("JenaGraphStore", "DROP, then put"): AGAIN,
    ("JenaUpdate", "DROP, then INSERT"): AGAIN,
    ("JenaGraphStore", "fetch of the default graph as RDF/XML"): CONTROL,
    ("JenaGraphStore", "pages as RDF/XML"): CONTROL,
    ("Rdf4jRio", "pages as RDF/XML"): CONTROL,
    ("Rdf4jRio", "pages as N-Quads, in the default graph"): STORED,
    ("Rdf4jRio", "pages as TriG, in the default graph"): STORED,
    ("Rdf4jRepository", "everything of the robot"): "results in XML hold characters that XML has not",
    ("JenaQuery", "ASK as CSV"): "Jena reads a boolean in CSV as a table with one column, `_askResult`",
    ("JenaQuery", "ASK as TSV"): "Jena reads a boolean in TSV as a table with one column, `?_askResult`",
}
"""What does not work yet, and what it lacks."""


@pytest.fixture(scope="module")
def found(server: Any) -> Mapping[Check, str | None]:
    """What became of each check."""
    return outcomes(java("Main", server.url), PATIENCE)


@pytest.mark.parametrize("check", declared(SOURCES, PENDING))
def test_client_in_java(found: Mapping[Check, str | None], check: Check) -> None:
    judge(found, check)
