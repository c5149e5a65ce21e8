"""Creation of missing resources, and the permissions for it."""

from __future__ import annotations

import socket
from collections.abc import Callable

import pytest

from tests.server.auth.conftest import AGENTS, RULES, Guarded

UPDATE = {"Content-Type": "application/sparql-update"}
INSERT = "INSERT DATA { <> <urn:p> 1 }"


def test_who_may_make_something_is_told_what(guarded: Guarded) -> None:
    for path in ("/data/open/nothing", "/data/open/gone"):
        for method in ("GET", "HEAD"):
            gone = guarded["admin"].put("/data/open/gone", content="", headers={"Content-Type": "text/turtle"})
            assert gone.status_code in (201, 204)
            guarded["admin"].delete("/data/open/gone").raise_for_status()
            for agent, may in (("admin", True), ("reader", True), ("commander", False)):
                answer = guarded[agent].request(method, path)
                assert answer.status_code in (404, 410)
                allowed = set(answer.headers.get("allow", "").split(", "))
                assert ({"PUT", "PATCH"} <= allowed) is may, agent
                assert ("accept-put" in answer.headers, "accept-patch" in answer.headers) == (may, may), agent


def test_a_post_makes_a_graph_where_its_agent_may_write(guarded: Guarded) -> None:
    for where in ("{}", "/graphs?graph={}"):
        for agent, path, may in (("reader", "open", True), ("commander", "open", False), ("reader", "secret", False)):
            url = f"/data/{path}/posted-{agent}-{len(where)}"
            name = str(guarded["admin"].base_url.join(url))
            answer = guarded[agent].post(
                where.format(name), content="<> <urn:p> 1 .", headers={"Content-Type": "text/turtle"}
            )
            assert answer.status_code in ((201,) if may else (403, 404)), (agent, path, answer.text)
            assert guarded["admin"].get(url).status_code == (200 if may else 404)


def test_silent_hides_what_an_agent_may_not_do_and_does_nothing(guarded: Guarded) -> None:
    for verb in ("DROP SILENT GRAPH <{}>", "COPY SILENT <{}> TO </data/secret/copy>"):
        guarded["admin"].put("/data/secret/there", content="", headers={"Content-Type": "text/turtle"})
        text, update = verb.format("/data/secret/there"), {"Content-Type": "application/sparql-update"}
        assert guarded["reader"].post("/sparql", content=text.replace("SILENT", ""), headers=update).status_code == 403
        assert guarded["reader"].post("/sparql", content=text, headers=update).status_code == 204
        assert guarded["admin"].get("/data/secret/there").status_code == 200
        assert guarded["admin"].get("/data/secret/copy").status_code == 404


def test_no_document_is_asked_for_by_an_agent_who_may_not_load_it_there(guard: Callable[..., Guarded]) -> None:
    with socket.create_server(("127.0.0.1", 0)) as listening:
        listening.settimeout(0.1)
        document = f"http://127.0.0.1:{listening.getsockname()[1]}/doc"
        guarded = guard(RULES, *AGENTS, options=("--allow-load", document))
        for silent, status in (("", 403), ("SILENT", 204)):
            text = f"LOAD {silent} <{document}> INTO GRAPH </data/secret/loaded>"
            assert guarded["reader"].post("/sparql", content=text, headers=UPDATE).status_code == status
        with pytest.raises(TimeoutError):
            listening.accept()


def test_a_patch_makes_something_where_its_agent_may_write(guarded: Guarded) -> None:
    for number, (agent, path, may) in enumerate(
        (("reader", "open", True), ("commander", "open", False), ("reader", "secret", False), ("admin", "secret", True))
    ):
        url = f"/data/{path}/patched-{number}"
        answer = guarded[agent].patch(url, content=INSERT, headers=UPDATE)
        assert (answer.status_code == 201) is may, (agent, path, answer.text)
        assert answer.status_code in (201, 403, 404)
        assert guarded["admin"].get(url).status_code == (200 if may else 404)
