"""W3C's tests of the SPARQL 1.1 Protocol for updates, by name, on graphs under `/data/`."""

from __future__ import annotations

from typing import TYPE_CHECKING
from urllib.parse import quote

import pytest

if TYPE_CHECKING:
    import httpx

    from tests.conformance.sparql.conftest import Endpoint, Store

FORM = "application/x-www-form-urlencoded"
UPDATE = "application/sparql-update"
ONE = "<http://example.org/data1> a ?one"
TWO = "<http://example.org/data2> a ?two"
THREE = "<http://example.org/data3> a ?three"
DONE = "<http://example.org/update> <http://example.org/is> 'done'"


def done(endpoint: Endpoint, graph: str) -> bool:
    """Whether the update had its effect on a graph."""
    return endpoint.ask(f"ASK {{ GRAPH <{graph}> {{ {DONE} }} }}")


def succeeded(answer: httpx.Response) -> bool:
    assert answer.status_code in (200, 204), answer.text
    return True


def direct(endpoint: Endpoint, text: str, **graphs: list[str]) -> httpx.Response:
    """Send an update by direct POST with a dataset; an underscore in a name stands for a hyphen."""
    named = {name.replace("_", "-"): value for name, value in graphs.items()}
    url = f"{endpoint.url}sparql"
    return endpoint.http.post(url, params=named, content=text.encode(), headers={"Content-Type": UPDATE})


def where(graph: str, pattern: str) -> str:
    return f"INSERT {{ GRAPH <{graph}> {{ {DONE} }} }} WHERE {{ {pattern} }}"


def test_update_post_form(endpoint: Endpoint, store: Store) -> None:
    graph = store.at("form")
    assert succeeded(endpoint.form(update=f"INSERT DATA {{ GRAPH <{graph}> {{ {DONE} }} }}"))
    assert done(endpoint, graph)


@pytest.mark.parametrize("how", ["direct", "form"])
def test_update_dataset_default_graph(endpoint: Endpoint, store: Store, three: tuple[str, str, str], how: str) -> None:
    """One and two of them (`update_dataset_default_graphs`), by direct POST (`update_post_direct`) and by a form."""
    for number, (pattern, graphs, expected) in enumerate(
        (
            (ONE, [three[0]], True),
            (TWO, [three[0]], False),
            (f"{ONE} . {TWO}", [three[0], three[1]], True),
            (f"{ONE} . {THREE}", [three[0], three[1]], False),
        )
    ):
        text = where(store.at(f"{number}"), pattern)
        if how == "direct":
            assert succeeded(direct(endpoint, text, using_graph_uri=graphs))
        else:
            assert succeeded(endpoint.form(update=text, using_graph_uri=graphs))
        assert done(endpoint, store.at(f"{number}")) is expected


def test_update_dataset_full(endpoint: Endpoint, store: Store, three: tuple[str, str, str]) -> None:
    """Default and named graphs (`update_dataset_named_graphs`)."""
    yes, no = store.at("yes"), store.at("no")
    pattern = f"{THREE} . GRAPH ?g1 {{ {ONE} }} GRAPH ?g2 {{ {TWO} }}"
    one, two, default = three
    assert succeeded(direct(endpoint, where(yes, pattern), using_graph_uri=[default], using_named_graph_uri=[one, two]))
    assert succeeded(direct(endpoint, where(no, pattern), using_graph_uri=[one], using_named_graph_uri=[default, two]))
    assert (done(endpoint, yes), done(endpoint, no)) == (True, False)


def test_update_base_uri(endpoint: Endpoint, store: Store) -> None:
    graph = store.at("base")
    assert succeeded(
        direct(
            endpoint, f"INSERT DATA {{ GRAPH <{graph}> {{ <http://example.org/s> <http://example.org/p> <test> }} }}"
        )
    )
    text = f"SELECT ?o {{ GRAPH <{graph}> {{ <http://example.org/s> <http://example.org/p> ?o }} }}"
    (row,) = endpoint.query(text).json()["results"]["bindings"]
    assert row["o"] == {"type": "uri", "value": f"{endpoint.url}test"}


def test_bad_update_get(endpoint: Endpoint, store: Store) -> None:
    graph = store.at("get")
    text = quote(f"INSERT DATA {{ GRAPH <{graph}> {{ {DONE} }} }}")
    assert endpoint.http.get(f"{endpoint.url}sparql?update={text}").status_code == 400
    assert not done(endpoint, graph)


def test_bad_multiple_updates(endpoint: Endpoint) -> None:
    """And an update together with a query."""
    assert endpoint.form(update=["CLEAR NAMED", "CLEAR DEFAULT"]).status_code == 400
    assert endpoint.form(query="ASK {}", update="CLEAR NAMED").status_code == 400
    for name, text in (("update", "CLEAR%20DEFAULT"), ("query", "ASK%20%7B%7D")):
        assert endpoint.post("CLEAR NAMED", UPDATE, f"?{name}={text}").status_code == 400


def test_bad_update_wrong_media_type(endpoint: Endpoint) -> None:
    """And none (`bad_update_missing_form_type`)."""
    answer = endpoint.post("CLEAR NAMED", "text/plain")
    assert answer.status_code == 415
    assert UPDATE in answer.headers["accept-post"]
    assert endpoint.post("update=CLEAR%20NAMED", None).status_code == 415


def test_bad_update_non_utf8(endpoint: Endpoint, store: Store) -> None:
    text = f"INSERT DATA {{ GRAPH <{store.at('ü')}> {{ {DONE} }} }}".encode("utf-16")
    assert endpoint.post(text, UPDATE).status_code == 400
    assert endpoint.post(text, f"{UPDATE}; charset=utf-16").status_code == 415


def test_bad_update_syntax(endpoint: Endpoint) -> None:
    answer = endpoint.form(update="CLEAR XYZ")
    assert answer.status_code == 400
    assert answer.headers["content-type"] == "application/problem+json"


@pytest.mark.parametrize("clause", ["USING", "USING NAMED", "WITH"])
def test_bad_update_dataset_conflict(
    endpoint: Endpoint, store: Store, three: tuple[str, str, str], clause: str
) -> None:
    graph = store.at("conflict")
    before, after = (f"WITH <{three[0]}> ", "") if clause == "WITH" else ("", f" {clause} <{three[0]}>")
    text = f"{before}INSERT {{ GRAPH <{graph}> {{ {DONE} }} }}{after} WHERE {{ ?s ?p ?o }}"
    for name in ("using_graph_uri", "using_named_graph_uri"):
        answer = direct(endpoint, text, **{name: [three[1]]})
        assert answer.status_code == 400, answer.text
        assert clause.partition(" ")[0] in answer.json()["detail"]
    assert not done(endpoint, graph)


# Beyond the tests of W3C


def test_an_update_as_a_query_is_refused(endpoint: Endpoint, store: Store) -> None:
    graph = store.at("a")
    text = f"INSERT DATA {{ GRAPH <{graph}> {{ {DONE} }} }}"
    assert endpoint.form(query=text).status_code == 400
    assert endpoint.post(text, "application/sparql-query").status_code == 400
    assert endpoint.form(update="ASK {}").status_code == 400
    assert not done(endpoint, graph)


def test_a_page_of_another_site_cannot_send_an_update(endpoint: Endpoint, store: Store) -> None:
    graph = store.at("forged")
    sent = {"update": f"INSERT DATA {{ GRAPH <{graph}> {{ {DONE} }} }}"}
    for headers in ({"Origin": "https://evil.example"}, {"Origin": "null"}, {"Sec-Fetch-Site": "cross-site"}):
        answer = endpoint.http.post(f"{endpoint.url}sparql", data=sent, headers=headers)
        assert answer.status_code == 403
    assert not done(endpoint, graph)


def test_a_server_that_only_reads_takes_no_update_and_says_why(read_only: Endpoint) -> None:
    text = f"INSERT DATA {{ GRAPH <{read_only.url}data/a> {{ {DONE} }} }}"
    for answer in (read_only.form(update=text), read_only.post(text, UPDATE)):
        assert answer.status_code == 403
        assert "read-only" in answer.json()["detail"]
    accepted = read_only.http.options(f"{read_only.url}sparql").headers["accept-post"]
    assert UPDATE not in accepted
    assert read_only.ask("ASK {}")
    described = read_only.http.get(f"{read_only.url}sparql", headers={"Accept": "text/turtle"}).text
    assert "SPARQL11Query" in described
    assert "SPARQL11Update" not in described
