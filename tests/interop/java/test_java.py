"""Clients in Java: Jena, RDF4J, the JDK's HttpClient, Apache's. Each check of `src` is a test here."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pytest

from tests.interop.checks import Check, declared, judge, outcomes
from tests.interop.java.maven import SOURCES, java

PATIENCE = 600.0


@pytest.fixture(scope="module")
def found(server: Any) -> Mapping[Check, str | None]:
    """The result of each check."""
    return outcomes(java("Main", server.url), PATIENCE)


@pytest.mark.parametrize("check", declared(SOURCES))
def test_client_in_java(found: Mapping[Check, str | None], check: Check) -> None:
    judge(found, check)
