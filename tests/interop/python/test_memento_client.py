"""memento_client, the library of the authors of RFC 7089: it finds the former states of a topic and a resource.

It finds their TimeGates by itself; without one it would query mementoweb.org.
"""

from __future__ import annotations

from collections.abc import Callable
from datetime import datetime
from typing import Any

import pytest

from tests.waiting import until

memento_client = pytest.importorskip("memento_client", reason="memento_client is missing: pip install '.[interop]'")
TOPIC = "topics/aircraft/engine/speed"


@pytest.fixture(scope="module")
def recorded(start_server: Callable[..., Any]) -> Any:
    server = start_server("aircraft", "--history", "/aircraft/engine/speed")
    assert server.http.post("/services/aircraft/start", json={}).status_code == 201
    until(lambda: server.http.get(f"/{TOPIC}?timemap").text.count('rel="memento"') > 20, "mementos")
    return server


@pytest.mark.parametrize(("year", "which"), [(1990, "first"), (2099, "last")])
def test_the_client_finds_the_closest_memento_and_the_ends(recorded: Any, year: int, which: str) -> None:
    url = recorded.url + TOPIC
    client = memento_client.MementoClient()
    found = client.get_memento_info(url, datetime(year, 1, 1))
    assert (found["original_uri"], found["timegate_uri"]) == (url, f"{url}?timegate")
    mementos = found["mementos"]
    assert {"closest", "first", "last"} <= mementos.keys()
    assert mementos["closest"]["http_status_code"] == 200
    assert mementos["closest"]["datetime"] == mementos[which]["datetime"]
    (at,) = mementos["closest"]["uri"]
    assert memento_client.MementoClient.is_memento(at)
    assert memento_client.MementoClient.is_timegate(f"{url}?timegate")
    assert client.get_original_uri(at) == url


def test_the_client_finds_a_memento_of_a_resource(recorded: Any) -> None:
    url = f"{recorded.url}resources/aircraft/engine/speed"
    client = memento_client.MementoClient()
    found = client.get_memento_info(url, datetime(2099, 1, 1))
    assert (found["original_uri"], found["timegate_uri"]) == (url, f"{url}?timegate")
    (at,) = found["mementos"]["closest"]["uri"]
    assert memento_client.MementoClient.is_memento(at)
    assert client.get_original_uri(at) == url
