"""Clients in Java: Jena, RDF4J, the JDK's HttpClient, Apache's. Each check of `src` is a test here."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pytest

from tests.interop.checks import Check, declared, judge, outcomes
from tests.interop.java.maven import SOURCES, java

PATIENCE = 300.0
PENDING: Mapping[Check, str] = {
    ("Rdf4jRepository", "a literal with a control character"): "results in XML hold characters that XML has not",
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
