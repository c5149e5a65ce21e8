"""Places of messages over HTTP: geometries of topics and recordings, in documents and queries."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable
from pathlib import Path
from typing import Any

import httpx
import pytest

from tests.server.auth.conftest import rule, token, tokens
from tests.waiting import until

pytestmark = pytest.mark.slow

PLACE = "?m geo:hasGeometry ?g . ?g a geo:Geometry, sf:Point ; geo:asWKT ?wkt"


@pytest.fixture(scope="module")
def rover(start_server: Callable[..., Any]) -> httpx.Client:
    """Start a rover with a history of ten odometries at least."""
    http: httpx.Client = start_server("rover:", "--history", "*").http
    count = "SELECT (COUNT(*) AS ?n) WHERE { </topics/odom> ros:past ?m }"
    until(lambda: int(ask(http, count)[0][0]) > 10, "some odometry")
    return http


def ask(http: httpx.Client, query: str) -> list[list[str]]:
    """Return the rows of a SELECT."""
    answer = http.post("/sparql", data={"query": query}, headers={"Accept": "text/csv"})
    assert answer.status_code == 200, answer.text
    return list(csv.reader(io.StringIO(answer.text)))[1:]


def test_a_query_finds_the_places_of_topics_by_terms_of_geosparql_alone(rover: httpx.Client) -> None:
    rows = ask(rover, f"SELECT ?m ?wkt {{ {PLACE} }}")
    frames = f"{rover.base_url}frames#"
    assert (f"{rover.base_url}topics/odom#message", f"<{frames}odom> POINT ZM(") in {
        (message, wkt.partition("(")[0] + "(") for message, wkt in rows
    }


def test_the_past_and_recordings_have_the_same_places(rover: httpx.Client) -> None:
    x = "<https://w3id.org/rosld/types/nav_msgs/msg/Odometry#pose>/<https://w3id.org/rosld/types/geometry_msgs/msg/PoseWithCovariance#pose>/<https://w3id.org/rosld/types/geometry_msgs/msg/Pose#position>/<https://w3id.org/rosld/types/geometry_msgs/msg/Point#x>"
    rows = ask(rover, f"SELECT ?m ?wkt ?x {{ </topics/odom> ros:past ?m . {PLACE} . ?m {x} ?x }} LIMIT 5")
    assert len(rows) == 5
    for message, wkt, number in rows:
        assert float(wkt.partition("(")[2].split()[0]) == float(number)
        turtle = rover.get(message.partition("#")[0], headers={"Accept": "text/turtle"}).text
        assert f'geo:asWKT "{wkt}"^^geo:wktLiteral' in turtle
    assert ask(rover, "SELECT ?g { </topics/odom> ros:past ?m . ?m geo:hasGeometry ?g } LIMIT 1")


def test_a_place_is_ignored_when_a_message_is_sent_back(rover: httpx.Client) -> None:
    url = "/topics/odom"
    body = rover.get(url, headers={"Accept": "text/turtle"}).text
    assert "geo:hasGeometry" in body
    answer = rover.put(f"{url}?dry-run=true", content=body, headers={"Content-Type": "text/turtle"})
    assert "hasGeometry" not in answer.text


def test_the_pose_of_the_odometry_is_the_origin_of_the_robots_frame_at_its_own_time(rover: httpx.Client) -> None:
    rover.put("/topics/cmd_vel", json={"linear": {"x": 0.3}, "angular": {"z": 0.4}})
    own = "BIND(ros:transform(?wkt, 'base_link') AS ?own)"
    for link in ("latest", "past"):
        query = f"SELECT ?own {{ </topics/odom> ros:{link} ?m . ?m geo:hasGeometry/geo:asWKT ?wkt . {own} }} LIMIT 20"
        rows = until(lambda query=query: [row for row in ask(rover, query) if any(row)], f"transforms of ros:{link}")
        for (text,) in rows:
            frame, _, numbers = text.partition(" POINT ZM(")
            assert frame == f"<{rover.base_url}frames#base_link>"
            assert list(map(float, numbers.split()[:3])) == pytest.approx([0, 0, 0], abs=0.2)


def test_a_query_selects_places_within_an_area_of_a_frame(rover: httpx.Client) -> None:
    area = f'"<{rover.base_url}frames#odom> POLYGON((-9 -9, 9 -9, 9 9, -9 9, -9 -9))"^^geo:wktLiteral'
    origin = f'"<{rover.base_url}frames#odom> POINT(0 0)"^^geo:wktLiteral'
    place = "</topics/odom> ros:past/geo:hasGeometry/geo:asWKT ?wkt"
    query = f"SELECT (geof:distance(?wkt, {origin}, uom:metre) AS ?d) {{ {place} FILTER(geof:sfWithin(?wkt, {area})) }}"
    rows = ask(rover, query)
    assert len(rows) > 10
    assert all(0 <= float(each) < 13 for (each,) in rows)
    assert ask(rover, f"SELECT * {{ {place} FILTER(geof:sfDisjoint(?wkt, {area})) }}") == []


def test_positions_on_the_earth_are_geojson_and_others_are_not(robot: Any, serving: Any) -> None:
    http: httpx.Client = serving()
    fix = {"latitude": 52.5, "longitude": 13.25, "altitude": 34.5}
    robot.topic("/fix", "sensor_msgs/msg/NavSatFix", fix)
    robot.topic("/pose", "geometry_msgs/msg/PoseStamped", {"header": {"frame_id": "map"}})
    accept = {"Accept": "application/geo+json, text/turtle;q=0.5"}
    answer = http.get("/topics/fix", headers=accept)
    assert (answer.status_code, answer.headers["content-type"]) == (200, "application/geo+json")
    feature = answer.json()
    assert feature["geometry"] == {"type": "Point", "coordinates": [13.25, 52.5, 34.5]}
    assert (feature["type"], feature["id"]) == ("Feature", f"{http.base_url}topics/fix#message")
    assert http.get("/topics/fix", headers={**accept, "If-None-Match": answer.headers["etag"]}).status_code == 304
    assert http.get("/topics/fix?format=geojson").json() == feature
    assert http.get("/topics/fix").headers["content-type"].startswith("text/turtle")
    assert http.get("/topics/pose", headers=accept).headers["content-type"].startswith("text/turtle")
    assert http.get("/topics/pose", headers={"Accept": "application/geo+json"}).status_code == 406
    assert http.get("/topics/pose?format=geojson").status_code == 406
    robot.publishes("/fix", {**fix, "status": {"status": -1}})
    until(lambda: http.get("/topics/fix", headers=accept).json()["geometry"] is None, "no fix")
    assert "application/geo+json" in http.get("/openapi.json").text


def test_who_may_not_read_transforms_gets_none(start_server: Callable[..., Any], tmp_path: Path) -> None:
    rules = rule("anna", "read", "/**") + rule("guest", "read", "/**") + rule("guest", "read", "/topics/tf", deny=True)
    (tmp_path / "auth.toml").write_text(rules + tokens("anna", "guest"))
    http = start_server("rover:", "--auth", str(tmp_path / "auth.toml")).http
    place = "</topics/odom> ros:latest/geo:hasGeometry/geo:asWKT ?wkt BIND(ros:transform(?wkt, 'base_link') AS ?own)"
    for agent, found in (("anna", 1), ("guest", 0)):
        http.headers["Authorization"] = f"Bearer {token(agent)}"
        until(lambda: ask(http, f"SELECT ?wkt {{ {place} }}"), "a place")
        count = f"SELECT (COUNT(?own) AS ?n) {{ {place} }}"
        if found:
            until(lambda count=count: ask(http, count) == [["1"]], "a transform")
        assert ask(http, count) == [[str(found)]]
