"""Recordings over HTTP: their topics played, every message as a resource, nothing writable."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from rdflib import RDF, XSD, Graph, Literal, Namespace, URIRef
from rosbags.rosbag1 import Writer
from rosbags.typesys import Stores, get_typestore

from tests.waiting import until

JSON = {"Accept": "application/json"}
COUNT = 250


@pytest.fixture(scope="module")
def walk(tmp_path_factory: pytest.TempPathFactory, start_server: Callable[..., Any]) -> Any:
    """A recording of a walk, served: 250 points in 2.5 seconds, a latched name that is published once."""
    path = tmp_path_factory.mktemp("bags") / "walk.bag"
    write(path)
    return start_server(str(path))


def write(path: Path) -> None:
    types = get_typestore(Stores.ROS1_NOETIC)
    point, text = types.types["geometry_msgs/msg/Point"], types.types["std_msgs/msg/String"]
    with Writer(path) as bag:
        points = bag.add_connection("/walk/point", point.__msgtype__, typestore=types, callerid="/walker")
        names = bag.add_connection("/walk/name", text.__msgtype__, typestore=types, callerid="/walker", latching=1)
        start = 1_700_000_000_000_000_000
        bag.write(names, start, types.serialize_ros1(text(data="a walk"), text.__msgtype__))
        for index in range(1, COUNT):
            data = types.serialize_ros1(point(x=float(index), y=0.0, z=-0.5), point.__msgtype__)
            bag.write(points, start + index * 10_000_000, data)


def test_every_message_has_its_own_url_and_links_to_its_neighbours(walk: Any) -> None:
    assert walk.http.get("/bags/walk/messages/0", headers=JSON).json() == {"data": "a walk"}
    assert walk.http.get("/bags/walk/messages/100", headers=JSON).json() == {"x": 100.0, "y": 0.0, "z": -0.5}
    for odd in (COUNT, "-1", "01", "1.0", "x", "99999999999999999999"):
        assert walk.http.get(f"/bags/walk/messages/{odd}").status_code == 404
    links = walk.http.get("/bags/walk/messages/7").links
    assert links["prev"]["url"].endswith("/messages/6")
    assert links["next"]["url"].endswith("/messages/8")
    assert "prev" not in walk.http.get("/bags/walk/messages/0").links
    assert "next" not in walk.http.get(f"/bags/walk/messages/{COUNT - 1}").links


def test_the_messages_are_a_container_in_pages_that_holds_each_once(walk: Any) -> None:
    found: list[str] = []
    for number in range(3):
        page = walk.http.get(f"/bags/walk/messages/?page={number}", headers={"Accept": "application/n-triples"})
        assert page.status_code == 200
        found += [line.split("> <")[2].split(">")[0] for line in page.text.splitlines() if "ldp#contains" in line]
    assert found == [f"{walk.url}bags/walk/messages/{index}" for index in range(COUNT)]
    assert walk.http.get("/bags/walk/messages/?page=3").status_code == 404


def test_the_bag_tells_its_topics_its_counts_and_the_checksum_of_its_file(walk: Any, tmp_path: Path) -> None:
    text = walk.http.get("/bags/walk/", headers={"Accept": "application/n-triples"}).text
    assert "/walk/point" in text
    assert f'"{COUNT - 1}"' in text
    assert walk.http.get("/bags/walk", follow_redirects=False).status_code == 308
    path = tmp_path / "walk.bag"
    write(path)  # the same again
    expected = hashlib.sha256(path.read_bytes()).hexdigest()
    url = f"{walk.http.base_url}bags/walk/"
    node, terms = URIRef(f"{url}#checksum"), Namespace("http://spdx.org/rdf/terms#")

    def graph() -> Graph:
        return Graph().parse(data=walk.http.get(url, headers={"Accept": "text/turtle"}).text, format="turtle")

    found = until(lambda: (URIRef(url), terms.checksum, node) in (said := graph()) and said, "the checksum")
    assert (node, RDF.type, terms.Checksum) in found
    assert (node, terms.algorithm, terms.checksumAlgorithm_sha256) in found
    assert found.value(node, terms.checksumValue) == Literal(expected, datatype=XSD.hexBinary)
    asked = f"ASK {{ GRAPH <{url}> {{ <{node}> <{terms.checksumValue}> ?sum }} }}"
    assert walk.http.get("/sparql", params={"query": asked}, headers=JSON).json()["boolean"]


def test_a_bag_is_a_dataset_that_data_loaders_and_search_engines_read(walk: Any) -> None:
    url, profile = f"{walk.url}bags/walk/", 'application/ld+json;profile="http://mlcommons.org/croissant/1.0"'
    named = walk.http.get("/bags/walk/").links["alternate"]
    assert (named["url"], named["profile"]) == (f"{url}?format=croissant", "http://mlcommons.org/croissant/1.0")

    def described() -> Any:
        answer = walk.http.get("/bags/walk/", headers={"Accept": profile})
        assert (answer.status_code, answer.headers["content-type"]) == (200, profile)
        return answer.json()["distribution"][0].get("sha256") and answer.json()

    found = until(described, "the checksum")
    assert walk.http.get("/bags/walk/", params={"format": "croissant"}).json() == found
    assert (found["@type"], found["name"], sorted(found["keywords"])) == (
        "sc:Dataset",
        "walk",
        ["/walk/name", "/walk/point"],
    )
    assert found["temporalCoverage"] == "2023-11-14T22:13:20Z/2023-11-14T22:13:22.49Z"
    (file,) = found["distribution"]
    content = walk.http.get(file["contentUrl"]).content
    assert (file["sha256"], file["contentSize"]) == (hashlib.sha256(content).hexdigest(), f"{len(content)} B")
    assert {row["topics/name"]: row["topics/count"] for row in found["recordSet"][0]["data"]} == {
        "/walk/name": 1, "/walk/point": COUNT - 1,
    }  # fmt: skip
    page = walk.http.get("/bags/walk/", headers={"Accept": "text/html"}).text
    assert json.loads(page.partition('<script type="application/ld+json">')[2].partition("</script>")[0]) == found
    catalog = f"ASK {{ <{walk.url}.well-known/void#catalog> <http://www.w3.org/ns/dcat#dataset> <{url}> }}"
    assert walk.http.get("/sparql", params={"query": catalog}, headers=JSON).json()["boolean"]


def test_topics_play_and_a_latched_message_is_there_whenever_it_is_looked_at(walk: Any) -> None:
    def x() -> float:
        found: float = walk.http.get("/topics/walk/point", headers=JSON).json()["x"]
        return found

    before = x()
    until(lambda: x() != before, "another point")
    assert walk.http.get("/topics/walk/name", headers=JSON).json() == {"data": "a walk"}


def test_nothing_is_writable_and_allow_says_so(walk: Any) -> None:
    for path in ("/topics/walk/point", "/topics/new", "/bags/walk/messages/3", "/parameters/x", "/bags/walk/at"):
        there = "OPTIONS" if path in ("/topics/new", "/parameters/x") else "GET, HEAD, OPTIONS"
        assert walk.http.options(path).headers["allow"] == there, path
        for method in ("PUT", "PATCH", "DELETE", "POST"):
            answer = walk.http.request(method, path, json={"x": 1, "y": 2, "z": 3})
            assert answer.status_code == 405, (method, path)


def test_a_query_reads_recorded_messages_it_names(walk: Any) -> None:
    url = f"{walk.url}bags/walk/messages/42"
    point = "https://w3id.org/rosld/types/geometry_msgs/msg/Point#x"
    query = f"SELECT ?x WHERE {{ GRAPH <{url}> {{ ?m <{point}> ?x }} }}"
    answer = walk.http.get("/sparql", params={"query": query}, headers={"Accept": "text/csv"})
    assert answer.text.split() == ["x", "42.0"]


def test_once_rests_at_the_end(tmp_path: Path, serve: Callable[..., Any]) -> None:
    write(tmp_path / "walk.bag")
    served = serve(str(tmp_path / "walk.bag"), "--once", "--rate", "1000")

    def last() -> Any:
        return served.http.get("topics/walk/point", headers=JSON).json()

    end = {"x": float(COUNT - 1), "y": 0.0, "z": -0.5}
    until(lambda: last() == end, "the end")
    assert last() == end
