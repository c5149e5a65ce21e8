"""Writes of clients are in the dataset immediately: each graph has the triples of a GET."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from itertools import count

import httpx
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pyoxigraph import CanonicalizationAlgorithm, Dataset, NamedNode, Quad, RdfFormat, parse

from tests.waiting import once_started

pytestmark = pytest.mark.slow

LDP = "http://www.w3.org/ns/ldp#"
P = "<http://h/p>"
NTRIPLES, TURTLE = {"Accept": "application/n-triples"}, {"Content-Type": "text/turtle"}
UPDATE = {"Content-Type": "application/sparql-update"}
TURNS = count()


def canonical(content: bytes) -> set[str]:
    """Return the triples of N-Triples, independent of labels of blank nodes."""
    dataset = Dataset(Quad(*quad.triple) for quad in parse(content, RdfFormat.N_TRIPLES))
    dataset.canonicalize(CanonicalizationAlgorithm.UNSTABLE)
    return {str(quad) for quad in dataset}


def ask(http: httpx.Client, query: str, accept: str = "text/csv") -> httpx.Response:
    answer = once_started(lambda: http.post("/sparql", data={"query": query}, headers={"Accept": accept}))
    assert answer.status_code == 200, answer.text
    return answer


def differences(http: httpx.Client, below: str) -> list[str]:
    """Return the graphs below a container that are missing or differ from a GET."""
    found = ask(http, f"SELECT DISTINCT ?g {{ GRAPH ?g {{ ?s ?p ?o }} FILTER(STRSTARTS(STR(?g), '{below}')) }}")
    graphs = set(found.text.split()[1:])
    wrong = []
    for graph in graphs:
        said = http.get(graph, headers=NTRIPLES)
        there = ask(http, f"CONSTRUCT {{ ?s ?p ?o }} {{ GRAPH <{graph}> {{ ?s ?p ?o }} }}", NTRIPLES["Accept"])
        if said.status_code != 200 or canonical(said.content) != canonical(there.content):
            wrong.append(graph)
        members = [quad.object for quad in parse(said.content, RdfFormat.N_TRIPLES) if "ldp#contains" in str(quad)]
        wrong += [
            each.value
            for each in members
            if isinstance(each, NamedNode) and not {each.value, f"{each.value}.meta"} & graphs
        ]
    return wrong


NAMES = ("a", "b", "c/", "d/", "i/", "c/a", "c/b", "d/a", "i/a", "i/b", "d/c/", "d/c/a", "f")
DIRECT = f"<> <{LDP}membershipResource> <> ; <{LDP}hasMemberRelation> {P} . "
INVERSE = f"<> <{LDP}membershipResource> <a#it> ; <{LDP}isMemberOfRelation> {P} . "
INDIRECT = DIRECT.replace("<> ;", "<http://h/all> ;") + f"<> <{LDP}insertedContentRelation> <http://h/is> . "
MODELS = {"d/": ("DirectContainer", [DIRECT, INVERSE]), "i/": ("IndirectContainer", [INDIRECT])}
STEPS = st.tuples(st.sampled_from(NAMES), st.sampled_from(["put", "put", "patch", "delete"]), st.integers(0, 5))


def write(http: httpx.Client, url: str, name: str, kind: str, number: int) -> None:
    """Send a write, which may be refused as invalid."""
    said = f'<> <http://h/said> "{number}" , [ {P} [] ] , "kept" . '
    if name.startswith("i/") and name != "i/":
        said += f"<> <http://h/is> <http://h/{number}> ."
    if kind == "delete":
        answer = http.delete(url)
    elif kind == "patch":
        old, new = "<> <http://h/said> ?o", f"<> <http://h/said> {number} , 'x'@en"
        text = f"DELETE {{ {old} }} INSERT {{ {new} }} WHERE {{ {old} }}"
        answer = http.patch(url, content=text, headers=UPDATE)
    elif name == "f":
        answer = http.put(url, content=bytes(number), headers={"Content-Type": "image/png"})
    elif name in MODELS:
        model, memberships = MODELS[name]
        link = {"Link": f'<{LDP}{model}>; rel="type"'}
        answer = http.put(url, content=said + memberships[number % len(memberships)], headers=TURTLE | link)
    else:
        answer = http.put(url, content=said, headers=TURTLE)
    assert answer.status_code < 500, answer.text


@given(st.lists(st.lists(STEPS, max_size=8), max_size=4))
@settings(max_examples=12)
def test_graphs_say_what_a_get_says_whatever_is_written(
    http: httpx.Client, batches: list[list[tuple[str, str, int]]]
) -> None:
    below = str(http.base_url.join(f"/data/sync{next(TURNS)}/"))
    assert http.put(below, content="", headers=TURTLE).status_code == 201
    for batch in batches:
        for name, kind, number in batch:
            write(http, below + name, name, kind, number)
        assert differences(http, below) == []


def test_a_patch_of_a_large_document_is_in_the_dataset_as_its_get_says_it(http: httpx.Client) -> None:
    many = "".join(f'<http://h/{number}> {P} "{number:0100}" .\n' for number in range(4000))
    patches = (
        "INSERT DATA {}",
        f'DELETE DATA {{ <http://h/1> {P} "{1:0100}" }} ; INSERT DATA {{ <http://h/1> {P} 01, "x"@en }}',
        f"DELETE WHERE {{ <http://h/1> {P} ?o }}",
        f"INSERT DATA {{ <> {P} [ {P} 2 ] }}",
    )
    below = str(http.base_url.join("/data/many/"))
    assert http.put(f"{below}large", content=many, headers=TURTLE).status_code == 201
    assert differences(http, below) == []
    for patch in patches:
        assert http.patch(f"{below}large", content=patch, headers=UPDATE).status_code == 204
        assert differences(http, below) == []
    assert http.delete(f"{below}large").status_code == 204
    assert differences(http, below) == []


def test_no_query_sees_a_part_of_a_write_and_each_sees_those_before_it(http: httpx.Client) -> None:
    names = [f"<data/part/{number}>" for number in range(30)]

    def write_all(turn: int) -> None:
        emptied = " ; ".join(f"DELETE WHERE {{ GRAPH {name} {{ ?s {P} ?o }} }}" for name in names)
        filled = " ".join(f"GRAPH {name} {{ {name} {P} {turn} }}" for name in names)
        answer = http.post("/sparql", content=f"{emptied} ; INSERT DATA {{ {filled} }}", headers=UPDATE)
        assert answer.status_code == 204, answer.text

    with ThreadPoolExecutor(1) as writer:
        write_all(0)
        last = 0
        writing = writer.submit(lambda: [write_all(turn) for turn in range(1, 15)])
        while not writing.done():
            answer = ask(
                http, f"SELECT ?o (COUNT(*) AS ?n) {{ ?g {P} ?o FILTER(CONTAINS(STR(?g), '/part/')) }} GROUP BY ?o"
            )
            turn, number = answer.text.split()[1].split(",")
            assert int(turn) >= last
            assert number == "30"
            last = int(turn)
        writing.result()
