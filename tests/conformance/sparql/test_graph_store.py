"""W3C's tests of the SPARQL 1.1 Graph Store HTTP Protocol, by name: graphs identified by `?graph=` and by their URLs.

Tests state where the server deviates on purpose.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import httpx

if TYPE_CHECKING:
    from tests.conformance.sparql.conftest import Endpoint, Store

TURTLE = "text/turtle"
PREFIXES = "@prefix foaf: <http://xmlns.com/foaf/0.1/> . @prefix v: <http://www.w3.org/2006/vcard/ns#> .\n"
JOHN = PREFIXES + "<> a foaf:Person ; foaf:businessCard [ a v:VCard ; v:fn 'John Doe' ] ."
JANE = PREFIXES + "<> a foaf:Person ; foaf:businessCard [ a v:VCard ; v:fn 'Jane Doe' ] ."
NAMED_JANE = PREFIXES + "<> foaf:name 'Jane Doe' ."
ALICE = PREFIXES + "[] a foaf:Person ; foaf:businessCard [ a v:VCard ; v:given-name 'Alice' ] ."
MULTIPART = [
    ("first", ("first.ttl", PREFIXES + "<> foaf:name 'Jane Doe' .", "text/turtle; charset=utf-8")),
    ("second", ("second.ttl", PREFIXES + "<> foaf:givenName 'Jane' ; foaf:familyName 'Doe' .", "text/turtle")),
]


def posted(store: Store, name: str, files: list[tuple[str, tuple[str, str, str]]]) -> httpx.Response:
    """Send a POST of multipart/form-data to a graph."""
    http = store.endpoint.http
    if store.direct:
        return http.post(store.at(name), files=files)
    return http.post(f"{store.endpoint.url}graphs", params={"graph": store.at(name)}, files=files)


def test_put__initial_state(graphs: Store) -> None:
    answer = graphs.send("PUT", "x/person", JOHN, "text/turtle; charset=utf-8")
    assert answer.status_code == 201
    assert answer.headers["location"] == graphs.at("x/person")
    answer = graphs.send("GET", "x/person", Accept=TURTLE)
    assert (answer.status_code, answer.headers["content-type"]) == (200, "text/turtle; charset=utf-8")
    assert graphs.holds("x/person", JOHN)
    assert graphs.at("x/person") in graphs.send("GET", "x/", Accept=TURTLE).text


def test_put__graph_already_in_store(graphs: Store) -> None:
    graphs.put("person/1", JOHN)
    assert graphs.send("PUT", "person/1", JANE, TURTLE).status_code == 204
    assert graphs.holds("person/1", JANE)


def test_put__default_graph(endpoint: Endpoint, store: Store) -> None:
    """Data for the default graph is stored in one document."""
    url, typed = f"{endpoint.url}graphs?default", {"Content-Type": TURTLE}
    endpoint.http.delete(url)
    made = endpoint.http.put(url, content=JOHN, headers=typed)
    assert (made.status_code, made.headers["location"]) == (201, f"{endpoint.url}data/default")
    assert endpoint.http.put(url, content=ALICE, headers=typed).status_code == 204
    assert store.holds(f"{endpoint.url}data/default", ALICE)
    assert endpoint.http.post(url, content=JANE, headers=typed).status_code == 204
    assert store.holds(f"{endpoint.url}data/default", ALICE + JANE)
    assert endpoint.http.delete(url).status_code == 204
    assert endpoint.http.get(f"{endpoint.url}data/default").status_code == 410


def test_get_of_put__default_graph(endpoint: Endpoint, store: Store) -> None:
    """Data in any graph is in the default graph."""
    store.put("a", "<http://example.org/in-any> <http://example.org/p> 1 .")
    url, accept = f"{endpoint.url}graphs?default", {"Accept": "application/n-triples"}
    answer = endpoint.http.get(url, headers=accept)
    assert (answer.status_code, answer.headers["content-type"]) == (200, "application/n-triples")
    assert "<http://example.org/in-any> <http://example.org/p>" in answer.text
    head = endpoint.http.head(url, headers=accept)
    assert (head.status_code, head.headers["content-type"]) == (200, "application/n-triples")
    assert endpoint.http.get(f"{endpoint.url}graphs?default&format=jsonld").headers["content-type"].endswith("ld+json")


def test_the_default_graph_is_as_limited_as_a_query(endpoint: Endpoint) -> None:
    answer = endpoint.http.get(f"{endpoint.url}graphs?default&timeout=0.000001")
    assert answer.status_code == 503
    assert endpoint.http.get(f"{endpoint.url}graphs?default&timeout=never").status_code == 400


def test_put__mismatched_payload(graphs: Store) -> None:
    xml = '<?xml version="1.0"?><rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#"/>'
    assert graphs.send("PUT", "person/1", xml, TURTLE).status_code == 400
    assert graphs.send("GET", "person/1").status_code == 404


def test_delete__existing_graph(graphs: Store) -> None:
    """410 rather than 404 afterwards, until the graph is written again (RFC 9110 15.5.11)."""
    graphs.put("person/2", JOHN)
    for method in ("PUT", "POST"):
        assert graphs.send("DELETE", "person/2").status_code == 204
        assert graphs.send("GET", "person/2").status_code == 410
        assert graphs.send(method, "person/2", JOHN, TURTLE).status_code == 201
        assert graphs.holds("person/2", JOHN)


def test_post__existing_graph(graphs: Store) -> None:
    graphs.put("person/1", JANE)
    assert graphs.send("POST", "person/1", NAMED_JANE, TURTLE).status_code == 204
    assert graphs.holds("person/1", JANE + NAMED_JANE.removeprefix(PREFIXES))


def test_post__multipart_formdata(graphs: Store) -> None:
    graphs.put("person/1", JANE)
    assert posted(graphs, "person/1", MULTIPART).status_code == 204
    assert graphs.holds("person/1", JANE + "<> foaf:name 'Jane Doe' ; foaf:givenName 'Jane' ; foaf:familyName 'Doe' .")


def test_post__create__new_graph(graphs: Store) -> None:
    """POST to the store, or to the container that is one; then of nothing to the graph (`get_of_post__after_noop`)."""
    endpoint, media_type = graphs.endpoint, "text/turtle; charset=utf-8"
    url = f"{endpoint.url}data/" if graphs.direct else f"{endpoint.url}graphs"
    answer = endpoint.http.post(url, content=ALICE, headers={"Content-Type": media_type})
    assert answer.status_code == 201, answer.text
    graph = answer.headers["location"]
    assert graph.startswith(f"{endpoint.url}data/")
    assert graphs.holds(graph, ALICE)
    assert graphs.send("POST", graph, PREFIXES, media_type).status_code == 204
    assert graphs.holds(graph, ALICE)


def test_head_on_an_existing_graph(graphs: Store) -> None:
    graphs.put("person/1", JANE)
    head, get = (graphs.send(method, "person/1", Accept=TURTLE) for method in ("HEAD", "GET"))
    assert head.status_code == 200
    assert head.content == b""
    for name in ("content-type", "content-length", "etag"):
        assert head.headers[name] == get.headers[name]


def test_head_on_a_nonexisting_graph(graphs: Store) -> None:
    """And DELETE (`delete__nonexistent_graph`)."""
    assert [graphs.send(method, "person/4").status_code for method in ("HEAD", "DELETE")] == [404, 404]


# Beyond the tests of W3C: names of graphs


def test_relative_names_are_resolved_against_the_store(endpoint: Endpoint, store: Store) -> None:
    store.put("ü", JANE)
    path = store.at("%C3%BC").removeprefix(endpoint.url)
    for name in (path, f"/{path}", store.at("ü")):
        answer = endpoint.http.get(f"{endpoint.url}graphs", params={"graph": name}, headers={"Accept": TURTLE})
        assert answer.status_code == 200
        assert store.at("%C3%BC") in answer.text


def test_exactly_one_graph_is_named(endpoint: Endpoint) -> None:
    for method in ("GET", "HEAD", "PUT", "PATCH", "DELETE"):
        for query in ("?graph=data/a&default", "?graph=data/a&graph=data/b", "?default&default", ""):
            if query or method not in ("GET", "HEAD"):
                url = f"{endpoint.url}graphs{query}"
                answer = endpoint.http.request(method, url, headers={"Content-Type": TURTLE})
                assert answer.status_code == 400, (method, query)


def test_what_names_no_graph_is_refused(endpoint: Endpoint) -> None:
    for name in ("a b", "http://[", "data/../x", "data/%2E%2E/x", "graphs", "graphs?graph=data/x", "%"):
        answer = endpoint.http.get(f"{endpoint.url}graphs", params={"graph": name})
        assert answer.status_code in (400, 404), name
        assert answer.json()["detail"]


def test_graphs_of_other_places_are_not_here_and_cannot_be(endpoint: Endpoint, store: Store) -> None:
    for name in ("http://example.org/g", "urn:example:g", f"{endpoint.url}data/a#b"):
        for method in ("GET", "HEAD"):
            assert store.send(method, name).status_code == 404
        for method in ("PUT", "POST", "DELETE", "PATCH"):
            answer = store.send(method, name, JANE, TURTLE)
            assert answer.status_code == 403
            assert f"{endpoint.url}data/" in answer.json()["detail"]


# Stored data


def test_post_to_a_container_makes_a_graph_in_it(graphs: Store) -> None:
    graphs.put("c/", "")
    answer = graphs.send("POST", "c/", JANE, TURTLE, Slug="jane")
    assert answer.status_code == 201
    assert answer.headers["location"] == graphs.at("c/jane")
    assert graphs.holds("c/jane", JANE)


def test_parts_make_a_graph_that_is_named(store: Store) -> None:
    answer = posted(store, "new", MULTIPART)
    assert answer.status_code == 201
    said = PREFIXES + "<> foaf:name 'Jane Doe' ; foaf:givenName 'Jane' ; foaf:familyName 'Doe' ."
    assert store.holds(answer.headers["location"], said)
    store.put("c/", "")
    assert posted(store, "c/", MULTIPART).status_code == 415


def test_blank_nodes_of_one_name_stay_apart(graphs: Store) -> None:
    graphs.put("a", "<> <http://example.org/p> _:x . _:x <http://example.org/q> 1 .")
    graphs.send("POST", "a", "<> <http://example.org/p> _:x . _:x <http://example.org/q> 2 .", TURTLE)
    parts = [
        (name, (name, f"<> <http://example.org/p> _:x . _:x <http://example.org/q> {name} .", TURTLE)) for name in "34"
    ]
    posted(graphs, "a", parts)
    each = " , ".join(f"[ <http://example.org/q> {number} ]" for number in (1, 2, 3, 4))
    assert graphs.holds("a", f"<> <http://example.org/p> {each} .")


def test_what_is_no_rdf_makes_no_graph(store: Store) -> None:
    for media_type in ("text/plain", "application/json"):
        for method in ("PUT", "POST"):
            answer = store.send(method, "new", b"{}", media_type)
            assert answer.status_code == 415
            assert "text/turtle" in answer.headers[f"accept-{method.lower()}"]
        assert posted(store, "new", [("a", ("a", "{}", media_type))]).status_code == 415
    assert store.send("POST", "new", b"{}").status_code == 415
    assert store.send("GET", "new").status_code == 404


def test_parts_that_cannot_be_cut_apart_are_refused(graphs: Store) -> None:
    graphs.put("a", JANE)
    for media_type in ("multipart/form-data; boundary=x", "multipart/form-data"):
        assert graphs.send("POST", "a", b"--x\r\nno blank line\r\n--x--", media_type).status_code == 400
    assert graphs.holds("a", JANE)


def test_patch_changes_the_graph_and_no_other(graphs: Store) -> None:
    graphs.put("a", "<> <http://example.org/p> 1 .")
    update = "DELETE { <> ?p 1 } INSERT { <> ?p 2 } WHERE { <> ?p 1 }"
    assert graphs.send("PATCH", "a", update, "application/sparql-update").status_code == 204
    assert graphs.holds("a", "<> <http://example.org/p> 2 .")
    beyond = f"INSERT DATA {{ GRAPH <{graphs.at('b')}> {{ <> <http://example.org/p> 3 }} }}"
    assert graphs.send("PATCH", "a", beyond, "application/sparql-update").status_code == 422
    assert graphs.send("GET", "b").status_code == 404


def test_requests_are_conditional_as_on_the_url_itself(graphs: Store) -> None:
    graphs.put("a", JANE)
    etag = graphs.send("GET", "a", Accept=TURTLE).headers["etag"]
    assert graphs.endpoint.http.get(graphs.at("a"), headers={"Accept": TURTLE}).headers["etag"] == etag
    assert graphs.send("GET", "a", Accept=TURTLE, If_None_Match=etag).status_code == 304
    for method in ("PUT", "POST", "DELETE"):
        assert graphs.send(method, "a", JOHN, TURTLE, If_Match='"another.ttl"').status_code == 412
    assert graphs.send("POST", "a", NAMED_JANE, TURTLE, If_Match=etag).status_code == 204
    assert graphs.send("PUT", "a", JOHN, TURTLE, If_Match=etag).status_code == 412
    assert graphs.send("PUT", "a", JOHN, TURTLE, If_None_Match="*").status_code == 412


def test_a_write_answers_with_the_graph_where_that_is_preferred(graphs: Store) -> None:
    graphs.put("a", JANE)
    answer = graphs.send("POST", "a", NAMED_JANE, TURTLE, Prefer="return=representation", Accept=TURTLE)
    assert answer.status_code == 200
    assert answer.headers["content-location"] == graphs.at("a")
    assert "Jane Doe" in answer.text


# The robot's graphs


def test_a_graph_of_the_robot_answers_as_its_url_does(endpoint: Endpoint, store: Store) -> None:
    url = f"{endpoint.url}topics/cockpit/display"
    put = store.send("PUT", url, b'{"data": "through the store"}', "application/json")
    assert put.status_code == 204
    for method in ("GET", "HEAD", "OPTIONS"):
        here = store.send(method, url, Accept=TURTLE)
        there = endpoint.http.request(method, url, headers={"Accept": TURTLE})
        assert (here.status_code, here.content) == (there.status_code, there.content)
        for name in ("etag", "allow", "link", "content-type", "accept-put", "accept-patch"):
            assert here.headers.get(name) == there.headers.get(name)
    assert "through the store" in store.send("GET", url, Accept=TURTLE).text


def test_refusals_of_the_robot_are_those_of_the_url(endpoint: Endpoint, store: Store) -> None:
    url = f"{endpoint.url}topics/cockpit/display"
    for body, media_type in ((b'{"data": 5}', "application/json"), (b"x", "text/plain"), (b"no turtle", TURTLE)):
        here = store.send("PUT", url, body, media_type)
        there = endpoint.http.put(url, content=body, headers={"Content-Type": media_type})
        assert here.status_code == there.status_code >= 400
        assert here.json() == there.json()
    assert store.send("DELETE", f"{endpoint.url}nodes/").status_code == 405


def test_nothing_is_merged_into_what_the_robot_says(endpoint: Endpoint, store: Store) -> None:
    for path in ("topics/cockpit/display", "services/aircraft/start", "parameters/", "sparql", ""):
        answer = store.send("POST", endpoint.url + path, JANE, TURTLE)
        assert answer.status_code == 405
        assert "POST" not in answer.headers["allow"]
        assert "PUT or PATCH" in answer.json()["detail"]


def test_other_parameters_are_those_of_the_graph_s_url(endpoint: Endpoint) -> None:
    url = f"{endpoint.url}topics/cockpit/display"
    for params, media_type in (
        ({"graph": url, "format": "nt"}, "application/n-triples"),
        ({"graph": f"{url}?format=jsonld"}, "application/ld+json"),
    ):
        answer = endpoint.http.get(f"{endpoint.url}graphs", params=params)
        assert answer.headers["content-type"] == media_type


# The store itself


def test_the_store_is_linked_and_tells_how_to_name_a_graph(endpoint: Endpoint) -> None:
    def said(path: str) -> str:
        return endpoint.http.get(endpoint.url + path, headers={"Accept": "application/n-triples"}).text

    for path in ("", "sparql"):
        assert f"seeAlso> <{endpoint.url}graphs>" in said(path)
    assert f"<{endpoint.url}graphs?default>" in said("graphs")
    assert f"{endpoint.url}graphs?graph=URL" in said("graphs")


def test_options_tell_what_the_store_takes(endpoint: Endpoint) -> None:
    answer = endpoint.http.options(f"{endpoint.url}graphs")
    assert answer.status_code == 204
    assert set(answer.headers["allow"].split(", ")) == {"GET", "HEAD", "OPTIONS", "PUT", "POST", "PATCH", "DELETE"}
    assert "multipart/form-data" in answer.headers["accept-post"]
    assert endpoint.http.options(f"{endpoint.url}graphs?default").headers["allow"] == answer.headers["allow"]


def test_a_page_of_another_site_cannot_write_graphs(endpoint: Endpoint, store: Store) -> None:
    files = [("a", ("a.ttl", JANE, TURTLE))]
    for headers in ({"Origin": "https://evil.example"}, {"Sec-Fetch-Site": "cross-site"}):
        params = {"graph": store.at("forged")}
        answer = endpoint.http.post(f"{endpoint.url}graphs", params=params, files=files, headers=headers)
        assert answer.status_code == 403
    assert store.send("GET", "forged").status_code == 404


def test_a_server_that_only_reads_writes_no_graph(read_only: Endpoint) -> None:
    url, typed = f"{read_only.url}graphs", {"Content-Type": TURTLE}
    for method in ("PUT", "POST"):
        answer = read_only.http.request(method, url, params={"graph": "data/a"}, content=JANE, headers=typed)
        assert answer.status_code == 405
        assert "read-only" in answer.json()["detail"]
    assert read_only.http.post(url, content=JANE, headers=typed).status_code == 405
    assert read_only.http.options(url).headers["allow"] == "GET, HEAD, OPTIONS"
    assert read_only.http.get(url, params={"graph": ""}).status_code == 400
    assert read_only.http.get(url, params={"graph": "topics/"}).status_code == 200
