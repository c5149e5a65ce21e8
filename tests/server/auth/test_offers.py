"""The operations on offer to an agent are those that it may use, in every representation."""

from __future__ import annotations

from collections.abc import Iterator

import httpx
import pytest
from pyoxigraph import RdfFormat, parse

from rosld.adapters.base import AdapterOptions
from rosld.adapters.rover import rover_adapter
from rosld.ontology.vocab import hctl, htv
from tests.server.auth.conftest import clients, rule, tokens
from tests.server.robots.made_up import served

pytestmark = pytest.mark.slow

AGENTS = ("watcher", "operator", "admin")
RULES = (
    rule("watcher operator admin", "read", "/**")
    + rule("operator", "control", "/topics/cmd_vel", "/holds/**")
    + rule("admin", "control write administer", "/**")
)
CSV, NT, HTML = ({"Accept": type} for type in ("text/csv", "application/n-triples", "text/html"))
OFFERS = "SELECT DISTINCT ?method ?target { ?form htv:methodName ?method ; hctl:hasTarget ?target }"
ANY = "CONSTRUCT { ?s ?p ?o } { { ?s ?p ?o } UNION { ?s a ros:Property } }"


@pytest.fixture(scope="module")
def agents(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, httpx.Client]]:
    file = tmp_path_factory.mktemp("door") / "auth.toml"
    file.write_text(tokens(*AGENTS) + RULES)
    with served(rover_adapter("rover", AdapterOptions()), auth=file, client_rate=100000) as http:
        known = clients(str(http.base_url), *AGENTS)
        assert known["admin"].post("/topics/cmd_vel?for=60", json={}).status_code == 201
        yield known
        for client in known.values():
            client.close()


def rows(answer: httpx.Response) -> set[tuple[str, ...]]:
    assert answer.status_code == 200, answer.text
    return {tuple(line.split(",")) for line in answer.text.split("\r\n")[1:-1]}


def forms(answer: httpx.Response) -> set[tuple[str, str]]:
    """Return the methods and targets of all forms in N-Triples."""
    assert answer.status_code == 200, answer.text
    said = [quad.triple for quad in parse(answer.content, RdfFormat.N_TRIPLES)]
    methods = {each.subject: each.object.value for each in said if each.predicate == htv.methodName}  # type: ignore[union-attr]
    return {
        (methods[each.subject], each.object.value.partition("{")[0])  # type: ignore[union-attr]
        for each in said
        if each.predicate == hctl.hasTarget
    }


def test_what_queries_offer_an_agent_is_what_allow_lets_it_do(agents: dict[str, httpx.Client]) -> None:
    offered = {}
    for agent, http in agents.items():
        if agent == "anybody":
            continue
        found = {row[2:4] for row in rows(http.get("/queries/what-can-be-done", headers=CSV))}
        found |= rows(http.get("/sparql", params={"query": OFFERS}, headers=CSV))
        found |= forms(http.get("/sparql", params={"query": ANY}, headers=NT))
        found |= forms(http.get("/sparql", params={"query": "DESCRIBE <stop>"}, headers=NT))
        found |= forms(http.get("/graphs?default", headers=NT))
        offered[agent] = {(method, target.partition("{")[0]) for method, target in found if method != "GET"}
        for method, target in offered[agent]:
            allow = http.get(target, headers={"Accept": "text/turtle"}).headers["allow"]
            assert method in allow.split(", "), (agent, method, target)
    assert offered["watcher"] == set()
    assert offered["operator"] < offered["admin"]
    base = str(agents["admin"].base_url)
    assert ("POST", f"{base}topics/cmd_vel") in offered["operator"]
    assert ("POST", f"{base}stop") in offered["admin"] - offered["operator"]
