"""Clients in JavaScript: Comunica, rdflib.js, Inrupt's solid-client, jsonld.js. Each of their checks is a test here."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pytest

from tests.interop.checks import Check, declared, judge, outcomes
from tests.interop.javascript.node import SOURCES, node

PATIENCE = 200.0


@pytest.fixture(scope="module")
def found(server: Any) -> Mapping[Check, str | None]:
    """The result of each check."""
    return outcomes(node("main.mjs", server.url), PATIENCE)


@pytest.mark.parametrize("check", declared(SOURCES))
def test_client_in_javascript(found: Mapping[Check, str | None], check: Check) -> None:
    judge(found, check)
