"""Every URL and method as every agent: Allow, responses, descriptions, affordances and links are consistent."""

from __future__ import annotations

import json
from typing import Any

import pytest
from pyoxigraph import NamedNode, RdfFormat, parse

from rosld.ontology.vocab import hctl, htv
from tests.server.auth.conftest import AGENTS, Guarded

pytestmark = pytest.mark.slow

EVERYBODY = ("anybody", *AGENTS)
VERBS = ("GET", "HEAD", "OPTIONS", "PUT", "POST", "PATCH", "DELETE")
JUNK = {"Content-Type": "application/x-nothing"}
"""A body that nothing accepts: a permitted write is rejected for it (415), and has no effect."""


def described(guarded: Guarded, agent: str) -> dict[str, Any]:
    answer = guarded[agent].get("/openapi.json")
    assert answer.status_code == 200, answer.text
    found: dict[str, Any] = answer.json()
    return found


def operations(said: dict[str, Any]) -> dict[str, set[str]]:
    """Return the methods of each path; GET implies HEAD, and everything has OPTIONS."""
    found = {path: {name.upper() for name in item if name.upper() in VERBS} for path, item in said["paths"].items()}
    return {path: {*methods, *(("HEAD",) if "GET" in methods else ()), "OPTIONS"} for path, methods in found.items()}


PROBES = ("/healthz", "/readyz")
"""What anybody may read, whatever the rules."""


@pytest.mark.parametrize("agent", EVERYBODY)
def test_allow_the_description_and_the_answers_to_every_verb_agree(guarded: Guarded, agent: str) -> None:
    everything = operations(described(guarded, "admin"))
    mine = operations(described(guarded, agent))
    assert mine.keys() <= everything.keys()
    wrong = []
    for number, (path, whole) in enumerate(everything.items()):
        if "{" in path or (number + EVERYBODY.index(agent)) % 2:  # the other half of the paths is for the next agent
            continue
        asked = guarded[agent].options(path)
        allowed = {each.strip() for each in asked.headers.get("allow", "").split(",")} - {""}
        if asked.status_code in (401, 404):
            allowed = set()
            assert asked.status_code == (401 if agent == "anybody" else 404), path
        if path.startswith("/resources/") and guarded["admin"].get(path).status_code == 404:  # not on offer now
            assert allowed <= mine.get(path, set()) - {"GET", "HEAD"}
            continue
        told = mine.get(path, set()) - {"OPTIONS"}
        if path.startswith("/topics/"):  # DELETE is described wherever it may become allowed: once rosld publishes
            told -= {"DELETE"} - allowed
            whole -= {"DELETE"} - allowed
        if allowed - {"OPTIONS"} != told:
            wrong.append((path, allowed, mine.get(path)))
        for method in VERBS:
            if (
                method == "OPTIONS"
                or (method == "DELETE" and method in allowed)
                or path in ("/graphs", "/sparql", "/stop")
                or (path in PROBES and method in ("GET", "HEAD"))
            ):
                continue
            if method == "POST" and path.startswith("/data/"):
                continue  # accepts everything
            answer = guarded[agent].request(
                method, path, headers=JUNK, content=b"x" if method not in ("GET", "HEAD") else None
            )
            status = answer.status_code
            if method in allowed:
                fine = status not in (401, 403, 405)
            elif not allowed:
                fine = status == asked.status_code
            elif method in whole:
                fine = status == (401 if agent == "anybody" else 403)
            else:
                fine = status == 405 and answer.headers["allow"] == asked.headers["allow"]
            if not fine:
                wrong.append((path, method, status, allowed))
    assert not wrong


@pytest.mark.parametrize("agent", EVERYBODY)
def test_every_form_and_every_link_that_an_agent_is_shown_is_one_that_it_may_follow(
    guarded: Guarded, agent: str
) -> None:
    seen: set[str] = set()
    allowed: dict[str, str] = {}
    waiting = (
        ["/"]
        if agent in ("anybody", "commander", "admin")
        else ["/services/aircraft/start"]
        if agent == "typist"
        else ["/topics/", "/data/"]
    )
    wrong = []
    while waiting and len(seen) < 150:
        path = waiting.pop()
        if path in seen or path == "/.well-known/wot":  # it lists what may ever be on offer
            continue
        seen.add(path)
        answer = guarded[agent].get(path, headers={"Accept": "application/n-triples"})
        if answer.status_code != 200 or "n-triples" not in answer.headers["content-type"]:
            if answer.status_code in (401, 403, 404) and guarded["admin"].get(path).status_code != answer.status_code:
                wrong.append((path, answer.status_code))
            continue
        triples = [quad.triple for quad in parse(answer.content, RdfFormat.N_TRIPLES)]
        methods = {each.subject: each.object for each in triples if each.predicate == htv.methodName}
        for each in triples:
            if each.predicate == hctl.hasTarget:
                method = getattr(methods.get(each.subject), "value", "GET")
                target = each.object.value
                if target not in allowed:
                    allowed[target] = guarded[agent].options(target).headers.get("allow", "")
                if method not in allowed[target]:
                    wrong.append((path, method, target, allowed[target]))
            for term in (each.subject, each.object):
                if isinstance(term, NamedNode) and term.value.startswith(guarded.url):
                    waiting.append("/" + term.value[len(guarded.url) :].partition("#")[0])
    assert not wrong
    assert seen


@pytest.mark.parametrize("agent", ["anybody", "commander", "admin"])
def test_thing_descriptions_name_what_the_agent_may_do_and_how_it_says_who_it_is(guarded: Guarded, agent: str) -> None:
    answer = guarded[agent].get("/.well-known/wot")
    assert answer.status_code == 200
    thing = json.loads(answer.content)
    assert thing["securityDefinitions"]["bearer_sc"]["scheme"] == "bearer"
    assert thing["security"] == ["bearer_sc"]
    forms = [form for kind in ("properties", "actions") for one in thing[kind].values() for form in one["forms"]]
    assert bool(forms) == (agent != "anybody")
    ever = operations(described(guarded, agent))  # it lists all that may exist, not what is on offer now
    for form in forms:
        assert form["htv:methodName"] in ever["/" + form["href"][len(guarded.url) :].partition("{?")[0]]


def test_the_description_says_what_takes_a_token_and_refers_to_nothing_that_is_not_there(guarded: Guarded) -> None:
    said = described(guarded, "anybody")
    assert said["components"]["securitySchemes"].keys() == {"bearer", "basic"}
    assert {} in said["paths"]["/"]["get"]["security"]
    text = json.dumps(said)
    assert "/topics" not in said["paths"]
    for kind, parts in said["components"].items():
        for name in parts:
            assert kind == "securitySchemes" or f"#/components/{kind}/{name}" in text, (kind, name)
