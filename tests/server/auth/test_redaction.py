"""Consistent redaction: an agent's documents omit everything that it may not see, in every form."""

from __future__ import annotations

import re

import httpx
import pytest

from tests.server.auth.conftest import TURTLE, Guarded

pytestmark = pytest.mark.slow

SECRETS = re.compile(
    r"topics/cockpit|data/secret|resources/aircraft/engine|parameters/aircraft|nodes/aircraft|services/"
)
"""Resources that the reader may not see."""


def test_a_condition_is_judged_on_what_the_reader_may_read(guarded: Guarded) -> None:
    query = {"until": "aircraft.nowhere = 1", "timeout": "0"}
    hidden, seen = (guarded[agent].get("/parameters/", params=query) for agent in ("reader", "admin"))
    assert (hidden.status_code, seen.status_code) == (400, 400)
    assert "there is no aircraft" in hidden.text
    assert "there is no nowhere in aircraft" in seen.text


def test_agents_of_other_rights_have_other_entity_tags_of_one_state(guarded: Guarded) -> None:
    tags = [
        guarded[agent].get("/data/open/plan", headers={"Accept": "text/turtle"}).headers["etag"]
        for agent in ("admin", "reader")
    ]
    states, variants = zip(*(tag.strip('"').rsplit(".", 1) for tag in tags), strict=True)
    assert states[0] == states[1]
    assert variants[0] != variants[1]
    written = guarded["reader"].put(
        "/data/open/plan", content="<> a <#T>; <#p> </data/secret/plan> .", headers={**TURTLE, "If-Match": tags[1]}
    )
    assert written.status_code == 204


def test_affordances_and_forms_are_those_that_this_agent_may_use_with_tokens_of_its_own(guarded: Guarded) -> None:
    tokens: list[set[str]] = []
    for agent in ("commander", "admin", "reader"):
        told = guarded[agent].get("/resources/aircraft/", headers={"Accept": "text/turtle"}).text
        page = guarded[agent].get("/resources/aircraft/", headers={"Accept": "text/html"}).text
        assert ("invokeAction" in told) == ("<form" in page.partition("<main")[2]) == (agent != "reader")
        tokens.append(set(re.findall(r'name="[^"]*csrf[^"]*" value="([^"]+)"', page)))
    assert tokens[0]
    assert tokens[0].isdisjoint(tokens[1])


def solutions(client: httpx.Client, query: str) -> list[str]:
    answer = client.post("/sparql", data={"query": query}, headers={"Accept": "text/csv"})
    assert answer.status_code == 200, answer.text
    return answer.text.split("\r\n")[1:-1]


def test_the_answers_of_one_agent_are_kept_for_no_other(guarded: Guarded) -> None:
    query = "SELECT (COUNT(*) AS ?n) { GRAPH ?g { ?s a ?type } }"
    counts = {agent: solutions(guarded[agent], query) for agent in ("admin", "reader", "admin", "reader")}
    assert counts["admin"] != counts["reader"]
    assert guarded["anybody"].post("/sparql", data={"query": query}).status_code == 401


def test_an_update_changes_what_its_agent_may_change_and_reads_what_they_may_read(guarded: Guarded) -> None:
    def update(agent: str, text: str) -> int:
        return (
            guarded[agent]
            .post("/sparql", content=text, headers={"Content-Type": "application/sparql-update"})
            .status_code
        )

    assert update("reader", "INSERT DATA { GRAPH </data/open/note> { <#a> <#b> 1 } }") == 204
    assert update("reader", "INSERT DATA { GRAPH </data/secret/note> { <#a> <#b> 1 } }") == 403
    assert update("reader", "COPY </data/secret/plan> TO </data/open/copy>") == 403
    assert update("reader", "COPY </data/secret/nothing> TO </data/open/copy>") == 403
    assert (
        update(
            "reader", "INSERT { GRAPH </data/open/x> { ?s ?p ?o } } WHERE { GRAPH </data/secret/plan> { ?s ?p ?o } }"
        )
        == 403
    )
    assert update("commander", "INSERT DATA { GRAPH </data/open/note> { <#a> <#b> 2 } }") == 403
    assert guarded["admin"].get("/data/secret/note").status_code == 404
    assert guarded["admin"].get("/data/open/copy").status_code == 404


def test_the_graph_store_judges_the_graph_that_is_named(guarded: Guarded) -> None:
    for name in ("/data/secret/plan", "/data/secret/nothing", "/nodes/aircraft"):
        answer = guarded["reader"].get("/graphs", params={"graph": name})
        assert (answer.status_code, answer.json()["detail"]) == (404, "Not found, or not visible to you.")
        assert guarded["reader"].put("/graphs", params={"graph": name}, content="", headers=TURTLE).status_code == 404
    assert guarded["reader"].get("/graphs", params={"graph": "/data/open/plan"}).status_code == 200
    whole = guarded["reader"].get("/graphs?default").text
    assert not SECRETS.search(whole)


def test_a_name_that_is_not_for_one_to_give_counts_as_taken(guarded: Guarded) -> None:
    made = guarded["reader"].post("/data/", content="", headers={**TURTLE, "Slug": "secret"}).headers["location"]
    assert made.rpartition("/")[2] != "secret"


def test_a_404_tells_what_is_near_to_those_who_may_read_everything(guarded: Guarded) -> None:
    told = {agent: guarded[agent].get("/topics/cockpit/displai") for agent in ("admin", "reader")}
    assert {answer.status_code for answer in told.values()} == {404}
    assert "topics/cockpit/display" in told["admin"].text
    assert "display" not in told["reader"].text
    readable = guarded["reader"].get("/topics/aircraft/engine/sped")
    assert (readable.status_code, readable.json().get("near")) == (404, None)
