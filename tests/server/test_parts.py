"""`?below=`: the descriptions of a robot of hundreds of topics have parts of 100 kB; `/llms.txt`."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

import httpx
import pytest
from openapi_spec_validator import OpenAPIV31SpecValidator

from rosld.server.rest.path_item import MAX_PART
from tests.server.robots.asking import triples
from tests.server.robots.made_up import MadeUp, Serving, served
from tests.server.robots.many import furnish

pytestmark = pytest.mark.slow

TD = {"Accept": "application/td+json"}


@pytest.fixture(scope="module")
def many() -> Iterator[httpx.Client]:
    """A robot with 330 topics, and 150 more without namespaces."""
    robot = MadeUp()
    furnish(robot)
    robot.topics([f"/odom_{number}" for number in range(150)], "nav_msgs/msg/Odometry")
    with served(robot) as client:
        client.timeout = 60
        yield client


def descriptions(http: httpx.Client, url: str) -> Iterator[dict[str, Any]]:
    """Yield the parts of the description from one of them on, following `x-next` and `Link`."""
    while url:
        answer = http.get(url)
        assert answer.status_code == 200, answer.text
        assert len(answer.content) <= MAX_PART
        part = answer.json()
        yield part
        url = part.get("x-next", "")
        assert answer.links.get("next", {}).get("url", "") == url


def things(http: httpx.Client, url: str) -> Iterator[dict[str, Any]]:
    """Yield the parts of a Thing Description from one of them on, following links."""
    while url:
        answer = http.get(url, headers=TD)
        assert answer.status_code == 200, answer.text
        assert len(answer.content) <= MAX_PART
        part = answer.json()
        yield part
        url = next((link["href"] for link in part["links"] if link["rel"] == "next"), "")


def section(thing: dict[str, Any]) -> str:
    """Return the URL of the first part of a Thing Description that has several."""
    [url] = [link["href"] for link in thing["links"] if link["rel"] == "section"]
    assert isinstance(url, str)
    return url


def test_the_parts_of_a_description_are_small_valid_and_complete(many: httpx.Client) -> None:
    whole = many.get("/openapi.json").json()
    found: dict[str, Any] = {}
    for part in whole["x-parts"]:
        below = {path: item for each in descriptions(many, part["url"]) for path, item in each["paths"].items()}
        assert len(below) == part["paths"]
        found |= below
    assert found == whole["paths"]
    parts = list(descriptions(many, "/openapi.json?below=/"))
    assert list(found) == [path for part in parts for path in part["paths"]]
    assert {tag["name"] for part in parts for tag in part["tags"]} == {tag["name"] for tag in whole["tags"]}
    OpenAPIV31SpecValidator(parts[-1]).validate()


def test_a_part_describes_what_lies_below_a_path_and_nothing_else(many: httpx.Client) -> None:
    [part] = descriptions(many, "/openapi.json?below=/topics/camera_1/")
    names = ("", "camera_info", "image_raw", "image_raw/", "image_raw/compressed", "points")
    assert sorted(part["paths"]) == [f"/topics/camera_1/{name}" for name in names]
    assert part["paths"].items() <= many.get("/openapi.json").json()["paths"].items()
    assert "sensor_msgs.msg.PointCloud2" in part["components"]["schemas"]
    assert "trajectory_msgs.msg.JointTrajectory" not in part["components"]["schemas"]


def test_a_missing_part_is_refused_in_words(http: httpx.Client) -> None:
    for path, accept in (("/openapi.json", "application/json"), ("/.well-known/wot", "application/td+json")):
        for query, status, words in (
            ("below=topics", 400, "begin it with a slash"),
            ("below=/&part=-1", 400, "not a part number"),
            ("part=1e9", 400, "not a part number"),
            ("below=/&part=9999", 404, "the parts are"),
            ("below=/nothing/", 404, "/nothing/"),
        ):
            answer = http.get(f"{path}?{query}", headers={"Accept": accept})
            assert (answer.status_code, words in answer.text) == (status, True), (path, query, answer.text)


def test_a_part_has_an_entity_tag_of_its_own(http: httpx.Client) -> None:
    whole, part = http.get("/openapi.json"), http.get("/openapi.json?below=/topics/")
    assert whole.headers["etag"] != part.headers["etag"]
    again = http.get("/openapi.json?below=/topics/", headers={"If-None-Match": part.headers["etag"]})
    assert again.status_code == 304


def test_the_parts_of_a_thing_description_are_small_and_complete(many: httpx.Client) -> None:
    for path in ("/.well-known/wot", "/resources/"):
        whole = many.get(path, headers=TD).json()
        parts = list(things(many, section(whole)))
        assert len(parts) > 1
        for kind in ("properties", "actions"):
            assert {name: one for part in parts for name, one in part[kind].items()} == whole[kind]
        assert {part["id"] for part in parts} == {whole["id"]}


def test_a_part_of_a_thing_description_is_rdf_too(many: httpx.Client) -> None:
    url = "/.well-known/wot?below=/resources/battery_2/"
    [part] = things(many, url)
    assert list(part["properties"]) == ["battery_2/state", "battery_2/temperature"]
    names = {
        each.object.value
        for each in triples(many.get(url, headers={"Accept": "text/turtle"}))
        if each.predicate.value.endswith("td#name") and "battery_2/" in each.object.value
    }
    assert names == set(part["properties"])


def test_the_entry_leads_to_a_guide_for_language_models_whose_links_lead_on(http: httpx.Client) -> None:
    guide = http.get(http.get("/", headers={"Accept": "application/json"}).links["help"]["url"])
    assert guide.headers["content-type"] == "text/plain; charset=utf-8"
    title, _, summary = guide.text.splitlines()[:3]
    assert title.startswith("# ")
    assert summary.startswith("> ")
    urls = re.findall(r"\]\((\S+?)\)", guide.text)
    assert "/find?" in urls[0]
    assert "/?offer" in urls[1]
    assert "/queries/what-can-be-done" in urls[2]
    for url in urls:
        assert http.get(url).status_code in (200, 400), url  # SPARQL requires a query
    assert len(guide.content) <= 2048


def test_the_guide_of_a_read_only_robot_offers_no_writes(serving: Serving) -> None:
    guide = serving(read_only=True).get("/llms.txt").text
    assert "read-only" in guide
    assert "PUT" not in guide
