"""Mementos (RFC 7089): former states of topics and resources, found by time, listed, and only served once final."""

from __future__ import annotations

from collections.abc import Callable
from datetime import datetime, timezone
from email.utils import parsedate_to_datetime
from typing import Any

import pytest

from rosld.server.http.fields import parse_links
from tests.waiting import until

pytestmark = pytest.mark.slow

JSON = {"Accept": "application/json"}
NTRIPLES = {"Accept": "application/n-triples"}
SPEED = "/aircraft/engine/speed"
MEMENTO = "http://mementoweb.org/ns#"


@pytest.fixture(scope="module")
def gate(start_server: Callable[..., Any]) -> Any:
    """An aircraft in flight with a history of some of its topics, part of which is final."""
    server = start_server("aircraft", "--history", SPEED)
    assert server.http.post("/services/aircraft/start", json={}).status_code == 201
    listing = f"/topics{SPEED}?timemap"
    until(lambda: server.http.get(listing).text.count('rel="memento"') > 20, "mementos")
    return server


def links(answer: Any) -> dict[str, list[Any]]:
    """Return the links of a response by relation."""
    found: dict[str, list[Any]] = {}
    for each in parse_links(", ".join(answer.headers.get_list("link"))):
        for rel in each.rel.split():
            found.setdefault(rel, []).append(each)
    return found


def mementos(http: Any) -> list[Any]:
    """Return the mementos in the TimeMap of the topic."""
    listed = parse_links(http.get(f"/topics{SPEED}?timemap").text.replace("\n", ""))
    return [each for each in listed if "?at=" in each.target]


def datetime_of(answer: Any) -> datetime:
    return parsedate_to_datetime(answer.headers["memento-datetime"])


def test_a_recorded_topic_is_its_own_timegate_and_names_its_timemap(gate: Any) -> None:
    answer = gate.http.get(f"/topics{SPEED}", headers=JSON)
    assert "accept-datetime" in answer.headers["vary"].lower()
    assert "memento-datetime" not in answer.headers
    url = f"{gate.url}topics{SPEED}"
    assert [each.target for each in links(answer)["timegate"]] == [f"{url}?timegate"]
    assert [each.target for each in links(answer)["timemap"]] == [f"{url}?timemap"]
    other = gate.http.get("/topics/aircraft/position", headers=JSON)
    assert "timegate" not in links(other)
    assert "accept-datetime" not in other.headers["vary"].lower()


def test_a_timemap_lists_each_memento_with_its_time_in_link_format_and_rdf(gate: Any) -> None:
    answer = gate.http.get(f"/topics{SPEED}?timemap")
    assert answer.headers["content-type"].startswith("application/link-format")
    listed = parse_links(answer.text.replace("\n", ""))
    mementos = [each for each in listed if "memento" in each.rel.split()]
    assert any("original" in each.rel.split() and each.target == f"{gate.url}topics{SPEED}" for each in listed)
    for each in (mementos[0], mementos[len(mementos) // 2], mementos[-1]):
        one = gate.http.get(each.target, headers=JSON)
        assert one.status_code == 200
        assert dict(each.attributes)["datetime"] == one.headers["memento-datetime"]
        assert [found.target for found in links(one)["original"]] == [f"{gate.url}topics{SPEED}"]
    text = gate.http.get(f"/topics{SPEED}?timemap", headers=NTRIPLES).text
    assert text.count(f"<{MEMENTO}mementoDatetime>") >= len(mementos)
    assert f"<{mementos[0].target}>" in text


def test_a_timemap_goes_on_from_any_number(gate: Any) -> None:
    whole = [each.target for each in mementos(gate.http)]
    tenth = gate.http.get("/bags/history/messages/?start=10&limit=1", headers=JSON).json()["messages"][0]["time"]
    rest = gate.http.get(f"/topics{SPEED}?timemap&start=10").text
    assert [each for each in whole if f"<{each}>" in rest] == whole[10:]
    assert whole[10].endswith(tenth)
    assert gate.http.get(f"/topics{SPEED}?timemap&start=x", headers=JSON).status_code == 400


def test_the_timegate_leads_to_the_memento_of_that_time(gate: Any) -> None:
    listed = mementos(gate.http)
    for when in (0, len(listed) // 2, -1, "Thu, 01 Jan 1990 00:00:00 GMT", "Thu, 01 Jan 2099 00:00:00 GMT"):
        leads_to_memento(gate, listed, when)
    odd = gate.http.get(f"/topics{SPEED}", headers=JSON | {"Accept-Datetime": "long ago"}, follow_redirects=False)
    assert odd.status_code == 400


def leads_to_memento(gate: Any, listed: list[Any], when: int | str) -> None:
    """Request the time of a memento, or a time before or after all."""
    asked = when if isinstance(when, str) else dict(listed[when].attributes)["datetime"]
    answer = gate.http.get(f"/topics{SPEED}", headers=JSON | {"Accept-Datetime": asked}, follow_redirects=False)
    assert answer.status_code == 302
    assert "memento-datetime" not in answer.headers
    assert "accept-datetime" in answer.headers["vary"].lower()
    assert {"original", "timegate", "timemap", "first", "last", "memento"} <= links(answer).keys()
    assert len(links(answer)["timegate"]) == len(links(answer)["original"]) == len(links(answer)["timemap"]) == 1
    there = gate.http.get(f"/topics{SPEED}?timegate", headers=JSON | {"Accept-Datetime": asked}, follow_redirects=False)
    assert (there.status_code, there.headers["vary"]) == (302, answer.headers["vary"])
    assert there.headers["location"].startswith(f"{gate.url}topics{SPEED}?at=")
    memento = gate.http.get(answer.headers["location"], headers=JSON)
    assert memento.status_code == 200
    if "1990" in asked:
        assert answer.headers["location"] == listed[0].target
    elif "2099" not in asked:
        assert memento.headers["memento-datetime"] == asked


def test_a_resource_is_as_its_topic_was_and_offers_nothing(gate: Any) -> None:
    http = gate.http
    listed = mementos(gate.http)
    at = listed[-1].target.partition("?at=")[2]
    then = http.get(f"/topics{SPEED}?at={at}", headers=JSON).json()
    answer = http.get(f"/resources{SPEED}?at={at}", headers=JSON)
    assert answer.status_code == 200, answer.text
    assert answer.json() == then["data"]
    assert datetime_of(answer) == parsedate_to_datetime(dict(listed[-1].attributes)["datetime"])
    assert answer.headers["allow"] == "GET, HEAD, OPTIONS"
    assert http.put(f"/resources{SPEED}?at={at}", json=1).status_code == 400, "a write is of the present"
    whole = http.get(f"/resources/aircraft/engine/?at={at}", headers=JSON)
    assert whole.status_code == 200, whole.text
    assert whole.json()["speed"] == then["data"]
    assert http.get(f"/resources/aircraft/engine/?at={at}", headers={"Accept": "text/html"}).status_code == 200


def test_what_nobody_recorded_of_a_resource_is_said_and_not_invented(gate: Any) -> None:
    http = gate.http
    at = datetime.now(timezone.utc).isoformat().replace("+00:00", "Z")
    assert http.get("/resources/aircraft/power", headers=JSON).status_code == 200
    answer = http.get(f"/resources/aircraft/power?at={at}", headers=NTRIPLES)
    assert answer.status_code == 200, answer.text
    assert "/aircraft/get_power is not recorded" in answer.text
    assert "memento-datetime" not in answer.headers, "just now may still change"
    gone = http.get(f"/resources/aircraft/power?at={at}", headers=JSON)
    assert gone.status_code >= 400 or gone.json() is None


def test_a_resource_is_its_own_timegate(gate: Any) -> None:
    asked = {"Accept-Datetime": "Thu, 01 Jan 2099 00:00:00 GMT"}
    answer = gate.http.get(f"/resources{SPEED}", headers=JSON | asked, follow_redirects=False)
    assert answer.status_code == 302
    memento = gate.http.get(answer.headers["location"], headers=JSON)
    assert memento.status_code == 200
    assert "memento-datetime" in memento.headers
    assert gate.http.get(f"/resources{SPEED}?at=then", headers=JSON).status_code == 400
    odd = gate.http.get(f"/resources{SPEED}", headers=JSON | {"Accept-Datetime": "soon"}, follow_redirects=False)
    assert odd.status_code == 400


def test_the_timemap_of_a_resource_lists_the_messages_that_its_values_come_from(gate: Any) -> None:
    for path in (SPEED, "/aircraft/engine/"):
        lists_messages(gate, path)
    empty = gate.http.get("/resources/aircraft/power?timemap")
    assert empty.status_code == 200
    assert "memento" not in {rel for each in parse_links(empty.text.replace("\n", "")) for rel in each.rel.split()}


def lists_messages(gate: Any, path: str) -> None:
    now = gate.http.get(f"/resources{path}", headers=JSON)
    url = f"{gate.url}resources{path}"
    assert [each.target for each in links(now)["timemap"]] == [f"{url}?timemap"]
    assert "accept-datetime" in now.headers["vary"].lower()
    times = [each.target.partition("?at=")[2] for each in mementos(gate.http)]
    listed = parse_links(gate.http.get(f"/resources{path}?timemap").text.replace("\n", ""))
    found = [each for each in listed if "memento" in each.rel.split()]
    assert [each.target for each in found][: len(times)] == [f"{url}?at={each}" for each in times]
    one = gate.http.get(found[0].target, headers=JSON)
    assert (one.status_code, one.headers["memento-datetime"]) == (200, dict(found[0].attributes)["datetime"])
    text = gate.http.get(f"/resources{path}?timemap", headers=NTRIPLES).text
    assert f"<{found[0].target}>" in text


def test_without_a_history_the_present_is_told_whatever_time_is_asked_for(http: Any) -> None:
    asked = JSON | {"Accept-Datetime": "Thu, 01 Jan 2020 00:00:00 GMT"}
    assert http.get(f"/topics{SPEED}", headers=asked, follow_redirects=False).status_code == 200
    assert http.get(f"/resources{SPEED}?at=2020-01-01T00:00:00Z", headers=JSON).status_code == 404
