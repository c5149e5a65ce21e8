"""Reading and writing from web pages: CORS and Origin over HTTP."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import httpx
import pytest

DISPLAY = "/topics/cockpit/display"
FRIEND = {"Origin": "https://app.example"}
STRANGER = {"Origin": "https://other.example"}


@pytest.fixture(scope="module")
def shared(start_server: Callable[..., Any]) -> httpx.Client:
    """An aircraft whose server permits one origin."""
    return start_server("aircraft", "--cors-origin", FRIEND["Origin"]).http


def test_a_named_origin_reads_and_writes(shared: httpx.Client) -> None:
    read = shared.get("/topics/", headers=FRIEND)
    assert read.headers["access-control-allow-origin"] == FRIEND["Origin"]
    assert read.headers["vary"] == "Accept, Origin"
    exposed = shared.get("/sparql?query=ASK {}", headers=FRIEND)
    assert "Unread-Graphs" in exposed.headers["access-control-expose-headers"]
    assert shared.put(DISPLAY, json={"data": "friend"}, headers=FRIEND).status_code == 204
    asked = shared.options(DISPLAY, headers=FRIEND | {"Access-Control-Request-Method": "PUT"})
    assert "PUT" in asked.headers["access-control-allow-methods"]
    assert asked.headers["vary"] == "Accept, Origin"


def test_another_origin_reads_and_moves_nothing(shared: httpx.Client, http: httpx.Client) -> None:
    read = shared.get("/topics/", headers=STRANGER)
    assert "access-control-allow-origin" not in read.headers
    assert read.headers["vary"] == "Accept, Origin"
    assert shared.put(DISPLAY, json={"data": "stranger"}, headers=STRANGER).status_code == 403
    assert shared.get(DISPLAY, headers={"Accept": "application/json"}).json() != {"data": "stranger"}
    assert "access-control-allow-origin" not in http.get("/topics/", headers=FRIEND).headers, "without the option"
