"""A search finds the resources that the agent may read, and counts no others."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from tests.server.auth.conftest import Guarded, rule

RULES = (
    rule("reader", "read", "/find", "/topics/**", "/data/open/**")
    + rule("reader", "read", "/topics/cockpit/**", deny=True)
    + rule("admin", "read write control administer", "/**")
)
JSON = {"Accept": "application/json"}


@pytest.fixture(scope="module")
def guarded(guard: Callable[..., Guarded]) -> Guarded:
    found = guard(RULES, "reader", "admin")
    for path in ("/data/open/plan", "/data/secret/plan"):
        body, headers = b'<> <http://purl.org/dc/terms/title> "The zebra plan" .', {"Content-Type": "text/turtle"}
        assert found["admin"].put(path, content=body, headers=headers).status_code == 201
    return found


def names(guarded: Guarded, agent: str, query: str) -> list[str]:
    answer = guarded[agent].get("/find", params={"q": query}, headers=JSON)
    assert answer.status_code == 200, answer.text
    assert answer.json()["total"] == len(answer.json()["results"])
    return [each["url"].removeprefix(guarded.url) for each in answer.json()["results"]]


def test_what_may_not_be_read_is_neither_found_nor_counted(guarded: Guarded) -> None:
    assert names(guarded, "reader", "display") == []
    assert "topics/cockpit/display" in names(guarded, "admin", "display")
    assert names(guarded, "reader", "zebra") == ["data/open/plan"]
    assert len(names(guarded, "admin", "zebra")) == 2
    assert names(guarded, "reader", "speed") == ["topics/aircraft/engine/speed"]


def test_who_may_not_search_sees_no_box_and_no_link(guarded: Guarded) -> None:
    answer = guarded["anybody"].get("/find?q=speed", headers=JSON)
    assert answer.status_code == 401
    page = guarded["reader"].get("/topics/", headers={"Accept": "text/html"}).text
    assert 'class="find"' in page
    assert 'class="find"' not in guarded["anybody"].get("/topics/", headers={"Accept": "text/html"}).text
