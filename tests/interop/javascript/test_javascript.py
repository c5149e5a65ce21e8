"""Clients in JavaScript: Comunica, rdflib.js, Inrupt's solid-client, jsonld.js. Each check of theirs is a test here."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pytest

from tests.interop.checks import Check, declared, judge, outcomes
from tests.interop.javascript.node import SOURCES, node

PATIENCE = 200.0
AGAIN = "what was deleted cannot be made again yet"
UNSAID = "a 404 does not say yet that PUT and PATCH would make it"
PENDING: Mapping[Check, str] = {
    ("solid-client", "deleteSolidDataset, then saveSolidDatasetAt"): AGAIN,
    ("rdflib", "UpdateManager.update after DELETE makes it again"): AGAIN,
    ("comunica", "an update of a document that was deleted makes it again"): AGAIN,
    ("rdflib", "UpdateManager.update of a document that does not exist makes it"): UNSAID,
    ("comunica", "an update of a document that does not exist makes it"): UNSAID,
    ("comunica", "pages of all kinds"): "a stored query has no N-Quads yet",
    ("jsonld", "pages are understood"): "a context from another host is named yet",
    ("jsonld", "numbers have the values that N-Triples say"): "doubles are native numbers, which lose digits",
}
"""What does not work yet, and what it lacks."""


@pytest.fixture(scope="module")
def found(server: Any) -> Mapping[Check, str | None]:
    """What became of each check."""
    return outcomes(node("main.mjs", server.url), PATIENCE)


@pytest.mark.parametrize("check", declared(SOURCES, PENDING))
def test_client_in_javascript(found: Mapping[Check, str | None], check: Check) -> None:
    judge(found, check)
