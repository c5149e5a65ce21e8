"""Large documents are redacted for each agent, outside of the event loop."""

from __future__ import annotations

import httpx
import pytest

from tests.server.auth.conftest import TURTLE, Guarded

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("frozen_heap")]

LINKS = 20_000
BUSY_SECONDS = 0.1
SECRET, OPEN = "/data/secret/plan", "/data/open/plan"


@pytest.fixture(scope="module")
def large(guarded: Guarded) -> str:
    """The path of a document with very many links, half of them to resources that the reader may not see."""
    links = ", ".join(f"<{path}?{number}#part>" for number in range(LINKS // 2) for path in (SECRET, OPEN))
    with httpx.Client(base_url=guarded.url, headers=guarded["admin"].headers, timeout=120) as admin:
        assert admin.put("/data/open/links", content=f"<> <#to> {links} .", headers=TURTLE).status_code == 201
    return "/data/open/links"


def test_what_is_large_is_told_without_what_the_reader_may_not_know(guarded: Guarded, large: str) -> None:
    for accept in ("text/turtle", "application/ld+json", "text/html"):
        found = {}
        for agent in ("reader", "admin"):
            answer = guarded[agent].get(large, headers={"Accept": accept}, timeout=120)
            assert answer.status_code == 200
            found[agent] = answer
        assert SECRET not in found["reader"].text
        assert OPEN in found["reader"].text
        assert SECRET in found["admin"].text
        assert found["reader"].headers["etag"] != found["admin"].headers["etag"]
        told = guarded["admin"].get("/status", headers={"Accept": "application/json"}).json()
        assert told["longestWork"] < BUSY_SECONDS
