"""What could be made where nothing is, and who may make it."""

from __future__ import annotations

import pytest

from tests.server.access.conftest import Guarded

UPDATE = {"Content-Type": "application/sparql-update"}
INSERT = "INSERT DATA { <> <urn:p> 1 }"


@pytest.mark.parametrize("path", ["/data/open/nothing", "/data/open/gone"])
@pytest.mark.parametrize("method", ["GET", "HEAD"])
def test_who_may_make_something_is_told_what(method: str, path: str, guarded: Guarded) -> None:
    gone = guarded["admin"].put("/data/open/gone", content="", headers={"Content-Type": "text/turtle"})
    assert gone.status_code in (201, 204)
    guarded["admin"].delete("/data/open/gone").raise_for_status()
    for agent, may in (("admin", True), ("reader", True), ("commander", False)):
        answer = guarded[agent].request(method, path)
        assert answer.status_code in (404, 410)
        allowed = set(answer.headers.get("allow", "").split(", "))
        assert ({"PUT", "PATCH"} <= allowed) is may, agent
        assert ("accept-put" in answer.headers, "accept-patch" in answer.headers) == (may, may), agent


def test_who_may_not_write_there_is_told_nothing(guarded: Guarded) -> None:
    for agent in ("reader", "typist", "anybody"):
        answer = guarded[agent].get("/data/secret/nothing")
        assert answer.status_code in (401, 403, 404)
        assert "accept-put" not in answer.headers
        assert "PUT" not in answer.headers.get("allow", "")


def test_a_patch_makes_something_where_its_agent_may_write(guarded: Guarded) -> None:
    for number, (agent, path, may) in enumerate(
        (("reader", "open", True), ("commander", "open", False), ("reader", "secret", False), ("admin", "secret", True))
    ):
        url = f"/data/{path}/patched-{number}"
        answer = guarded[agent].patch(url, content=INSERT, headers=UPDATE)
        assert (answer.status_code == 201) is may, (agent, path, answer.text)
        assert answer.status_code in (201, 403, 404)
        assert guarded["admin"].get(url).status_code == (200 if may else 404)
