"""Blank nodes, copies, SILENT and new graphs according to SPARQL 1.1 Update and the Graph Store Protocol."""

from __future__ import annotations

from itertools import count

import httpx
import pytest
from pyoxigraph import BlankNode, RdfFormat, Triple, parse

UPDATE = {"Content-Type": "application/sparql-update"}
TURTLE = {"Content-Type": "text/turtle"}
LDP = "http://www.w3.org/ns/ldp#"
_TURNS = count()


@pytest.fixture
def room() -> str:
    """A new path below `/data/` for one test."""
    return f"/data/letter{next(_TURNS)}/"


def update(client: httpx.Client, text: str) -> httpx.Response:
    """Send an update."""
    return client.post("/sparql", content=text.encode(), headers=UPDATE)


def done(client: httpx.Client, text: str) -> None:
    """Send an update, and check that it was carried out."""
    answer = update(client, text)
    assert answer.status_code == 204, answer.text


def put(client: httpx.Client, path: str, turtle: str, **headers: str) -> None:
    """Put a graph."""
    answer = client.put(path, content=turtle.encode(), headers=TURTLE | headers)
    assert answer.status_code in (201, 204), answer.text


def triples(client: httpx.Client, path: str) -> set[Triple]:
    """Return the triples of a graph."""
    answer = client.get(path, headers={"Accept": "application/n-triples"})
    assert answer.status_code == 200, answer.text
    return {quad.triple for quad in parse(answer.content, RdfFormat.N_TRIPLES)}


def said(client: httpx.Client, path: str) -> set[Triple]:
    """Return the triples of a graph about other resources than its own."""
    url = str(client.base_url.join(path))
    return {each for each in triples(client, path) if getattr(each.subject, "value", "") != url}


def blank_nodes(client: httpx.Client, path: str) -> set[BlankNode]:
    """Return the blank nodes of a graph."""
    terms = (term for each in triples(client, path) for term in (each.subject, each.object))
    return {term for term in terms if isinstance(term, BlankNode)}


# Patterns


@pytest.mark.parametrize(
    ("insert", "patterns"),
    [
        ("?s <urn:new> ?o", "?s <urn:p> ?o"),
        ("?s ?p <urn:new>", "?s ?p ?o . ?o <urn:p> ?s"),
        ("?s <urn:new> ?s", "?s <urn:p> ?s"),
        ("?s <urn:new> ?o", '?s <urn:p> "01"^^xsd:integer, ?o'),
        ("?s <urn:new> ?o", "_:a <urn:p> ?s, ?o"),
        ("?s <urn:new> ?o", "{ ?s <urn:q> ?m } ?m ^<urn:p>/<urn:p> ?o"),
        ("<urn:s> <urn:new> <urn:o>", ""),
        ("<urn:s> <urn:new> <urn:o>", "?s <urn:none> ?o"),
        ("?s <urn:new> ?o", "?s <urn:many> ?m . ?o <urn:many> ?n"),
    ],
)
def test_patterns_have_the_solutions_that_a_worker_finds(
    plane: httpx.Client, room: str, insert: str, patterns: str
) -> None:
    many = " ".join(f"<urn:{number}> <urn:many> {number % 7} ." for number in range(80))
    turtle = (
        f'<urn:a> <urn:p> <urn:b>, <urn:a>, 01, "1", "x"@en ; <urn:q> <urn:b> . <urn:b> <urn:p> <urn:a>, 1 . {many}'
    )
    found = []
    for name, filter in (("here", ""), ("worker", "FILTER(true)")):
        graph = plane.base_url.join(room + name)
        put(plane, room + name, turtle)
        done(
            plane, f"INSERT {{ GRAPH <{graph}> {{ {insert} }} }} WHERE {{ GRAPH <{graph}> {{ {patterns} {filter} }} }}"
        )
        done(plane, f"WITH <{graph}> DELETE {{ <urn:a> <urn:p> ?o }} WHERE {{ <urn:b> <urn:p> ?o {filter} }}")
        found.append(said(plane, room + name))
    assert found[0] == found[1]


# Blank nodes


def test_one_label_in_two_data_blocks_or_two_wheres_is_refused_and_said(plane: httpx.Client, room: str) -> None:
    """SPARQL 1.1 Query 19.6."""
    graph = f"GRAPH <{room}a>"
    where, says = "WHERE { _:b <urn:q> ?x }", "<urn:a> <urn:p> ?x"
    for text in (
        f"INSERT DATA {{ {graph} {{ _:b <urn:p> 1 }} }} ; INSERT DATA {{ {graph} {{ _:b <urn:p> 2 }} }}",
        f"INSERT {{ {graph} {{ {says} }} }} {where} ; DELETE {{ {graph} {{ {says} }} }} {where}",
    ):
        answer = update(plane, text)
        assert answer.status_code == 400
        assert answer.json()["detail"].startswith("_:b at 1:")
        assert plane.get(f"{room}a").status_code == 404


# Whole graphs


@pytest.mark.parametrize("verb", ["COPY", "MOVE", "ADD"])
def test_a_copy_has_nothing_that_the_server_says_of_the_source(plane: httpx.Client, room: str, verb: str) -> None:
    put(plane, f"{room}a", "<> <urn:p> 'own' ; <http://purl.org/dc/terms/format> 'own' . <urn:x> <urn:p> <> .")
    done(plane, f"{verb} <{room}a> TO <{room}b>")
    source = str(plane.base_url.join(f"{room}a"))
    assert sorted(map(str, said(plane, f"{room}b"))) == [
        f'<{source}> <http://purl.org/dc/terms/format> "own"',
        f'<{source}> <urn:p> "own"',
        f"<urn:x> <urn:p> <{source}>",
    ]


def test_a_copy_of_a_container_has_neither_its_members_nor_its_membership(plane: httpx.Client, room: str) -> None:
    put(
        plane,
        f"{room}c/",
        f"<> <{LDP}membershipResource> <urn:team> ; <{LDP}hasMemberRelation> <urn:has> ; <urn:p> 'own' . "
        "<urn:team> <urn:has> <urn:guest> .",
        Link=f'<{LDP}DirectContainer>; rel="type"',
    )
    put(plane, f"{room}c/member", "<> <urn:p> 1 .")
    done(plane, f"COPY <{room}c/> TO <{room}b>")
    source = str(plane.base_url.join(f"{room}c/"))
    assert sorted(map(str, said(plane, f"{room}b"))) == [
        f'<{source}> <urn:p> "own"',
        "<urn:team> <urn:has> <urn:guest>",
    ]


def test_a_moved_source_is_as_drop_leaves_it(plane: httpx.Client, room: str) -> None:
    for name in ("moved", "dropped"):
        put(plane, f"{room}{name}", "<urn:a> <urn:p> [ <urn:p> 1 ] .")
    done(plane, f"MOVE <{room}moved> TO <{room}there> ; DROP GRAPH <{room}dropped>")
    for name in ("moved", "dropped"):
        assert plane.get(f"{room}{name}").status_code == 410
        assert f"{room}{name}>" not in plane.get(room).text
    assert len(said(plane, f"{room}there")) == 2
    done(plane, f"CREATE GRAPH <{room}moved> ; CREATE GRAPH <{room}dropped>")


# SILENT


FAILING = [
    "LOAD {} <http://127.0.0.1:9/> INTO GRAPH <{}a>",
    "LOAD {} <http://127.0.0.1:9/>",
    "CLEAR {} GRAPH <{}none>",
    "CLEAR {} GRAPH </topics/cockpit/display>",
    "DROP {} GRAPH <{}none>",
    "DROP {} GRAPH </data/>",
    "DROP {} GRAPH <{}>",
    "CREATE {} GRAPH <{}kept>",
    "CREATE {} GRAPH <{}kept/>",
    "CREATE {} GRAPH <http://example.org/elsewhere>",
    "CREATE {} GRAPH </ontology>",
    "COPY {} <{}none> TO <{}kept>",
    "COPY {} <{}kept> TO </parameters/x>",
    "MOVE {} <{}none> TO <{}kept>",
    "MOVE {} </parameters/x> TO <{}kept>",
    "MOVE {} <{}> TO <{}other>",
    "ADD {} <{}none> TO <{}kept>",
]


def test_silent_is_silent_and_leaves_everything_as_it_was(plane: httpx.Client, room: str) -> None:
    """SPARQL 1.1 Update 3.1.4 and 3.2: the operation that fails has no effect, others are carried out."""
    put(plane, f"{room}kept", "<urn:a> <urn:p> 1 .")
    silent, wrong = [], []
    for text in FAILING:
        loud = text.replace("{}", "", 1).replace("{}", room)
        if (answer := update(plane, loud)).status_code not in (403, 409, 422):
            wrong.append((loud, answer.text))
        silent.append(text.replace("{}", "SILENT", 1).replace("{}", room))
    assert not wrong, wrong
    beside = f"INSERT DATA {{ GRAPH <{room}beside> {{ <urn:a> <urn:p> %d }} }}"
    done(plane, " ; ".join(f"{text} ; {beside % number}" for number, text in enumerate(silent)))
    assert len(said(plane, f"{room}beside")) == len(FAILING)
    assert len(said(plane, f"{room}kept")) == 1
    assert plane.get(f"{room}a").status_code == plane.get(f"{room}other").status_code == 404


def test_silent_excuses_no_other_operation_on_the_same_graph(plane: httpx.Client, room: str) -> None:
    text = "DROP SILENT GRAPH </ontology> ; INSERT DATA { GRAPH </ontology> { <urn:a> <urn:p> 1 } }"
    assert update(plane, f"INSERT DATA {{ GRAPH <{room}a> {{ <urn:a> <urn:p> 1 }} }} ; {text}").status_code == 403
    assert plane.get(f"{room}a").status_code == 404


# New graphs


@pytest.mark.parametrize("where", ["{0}", "/graphs?graph={0}"])
def test_post_to_a_new_url_makes_a_graph_and_then_merges_into_it(plane: httpx.Client, room: str, where: str) -> None:
    """Graph Store Protocol 5.5, by indirect and by direct graph identification (4.1, 4.2)."""
    url = str(plane.base_url.join(f"{room}new"))
    made = plane.post(where.format(url), content=b"<> <urn:p> [ <urn:q> 1 ] .", headers=TURTLE)
    assert (made.status_code, made.headers["location"]) == (201, url)
    merged = plane.post(where.format(url), content=b"<> <urn:p> [ <urn:q> 1 ] .", headers=TURTLE)
    assert merged.status_code == 204
    assert len(blank_nodes(plane, f"{room}new")) == 2
    plane.delete(url)
    assert plane.post(where.format(url), content=b"<urn:a> <urn:p> 1 .", headers=TURTLE).status_code == 201
    assert len(said(plane, f"{room}new")) == 1


def test_what_no_graph_is_made_of_is_posted_to_nothing(plane: httpx.Client, room: str) -> None:
    """A file requires PUT; and a body posted to a missing container was intended as a member."""
    assert plane.post(f"{room}file", content=b"x", headers={"Content-Type": "image/png"}).status_code == 404
    assert plane.post(f"{room}c/", content=b"<> <urn:p> 1 .", headers=TURTLE).status_code == 404
    assert plane.post(f"{room}new").status_code == 404
    answer = plane.get(f"{room}new")
    assert "POST" in answer.headers["allow"]
    assert "text/turtle" in answer.headers["accept-post"]
