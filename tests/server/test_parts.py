"""`?below=`: the descriptions of a robot of hundreds of topics come in parts of 100 kB; `/llms.txt`."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from typing import Any

import httpx
import orjson
import pytest
from hypothesis import given
from hypothesis import strategies as st
from openapi_spec_validator import OpenAPIV31SpecValidator

from rosld.server.openapi.description_parts import description_parts
from rosld.server.rest.parts import MAX_PART
from tests.server.conftest import Served
from tests.server.robots.asking import triples
from tests.server.robots.made_up import MadeUp, Serving
from tests.server.robots.many import COUNT, furnish

TD = {"Accept": "application/td+json"}


@pytest.fixture
def many(robot: MadeUp, serving: Serving) -> httpx.Client:
    """A robot of 330 topics."""
    furnish(robot)
    client = serving()
    client.timeout = 60
    return client


@pytest.fixture
def flat(robot: MadeUp, serving: Serving) -> httpx.Client:
    """A robot of 330 topics without namespaces."""
    for number in range(COUNT):
        robot.topic(f"/odom_{number}", "nav_msgs/msg/Odometry", published=True)
    client = serving()
    client.timeout = 60
    return client


def descriptions(http: httpx.Client, url: str) -> Iterator[dict[str, Any]]:
    """The parts of the description from one of them on, as `x-next` and `Link` lead to them."""
    while url:
        answer = http.get(url)
        assert answer.status_code == 200, answer.text
        assert len(answer.content) <= MAX_PART
        part = answer.json()
        yield part
        url = part.get("x-next", "")
        assert answer.links.get("next", {}).get("url", "") == url


def things(http: httpx.Client, url: str) -> Iterator[dict[str, Any]]:
    """The parts of a Thing Description from one of them on, as links lead to them."""
    while url:
        answer = http.get(url, headers=TD)
        assert answer.status_code == 200, answer.text
        assert len(answer.content) <= MAX_PART
        part = answer.json()
        yield part
        url = next((link["href"] for link in part["links"] if link["rel"] == "next"), "")


def section(thing: dict[str, Any]) -> str:
    """The URL of the first part of a Thing Description that has several."""
    [url] = [link["href"] for link in thing["links"] if link["rel"] == "section"]
    assert isinstance(url, str)
    return url


@pytest.mark.parametrize("which", ["many", "flat"])
def test_the_parts_of_a_description_are_small_and_valid_and_tell_all_of_it(
    which: str, request: pytest.FixtureRequest
) -> None:
    http: httpx.Client = request.getfixturevalue(which)
    whole = http.get("/openapi.json").json()
    told: dict[str, Any] = {}
    for part in whole["x-parts"]:
        found: dict[str, Any] = {}
        for each in descriptions(http, part["url"]):
            found |= each["paths"]
        assert len(found) == part["paths"]
        told |= found
    assert told == whole["paths"]
    parts = list(descriptions(http, "/openapi.json?below=/"))
    assert list(told) == [path for part in parts for path in part["paths"]]
    for part in (parts[0], parts[-1]):
        OpenAPIV31SpecValidator(part).validate()
    assert {tag["name"] for part in parts for tag in part["tags"]} == {tag["name"] for tag in whole["tags"]}


def test_a_part_tells_of_what_lies_below_a_path_and_of_nothing_else(many: httpx.Client) -> None:
    [part] = descriptions(many, "/openapi.json?below=/topics/camera_1/")
    names = ("", "camera_info", "image_raw", "image_raw/", "image_raw/compressed", "points")
    assert sorted(part["paths"]) == [f"/topics/camera_1/{name}" for name in names]
    assert part["paths"].items() <= many.get("/openapi.json").json()["paths"].items()
    assert "sensor_msgs.msg.PointCloud2" in part["components"]["schemas"]
    assert "trajectory_msgs.msg.JointTrajectory" not in part["components"]["schemas"]


@pytest.mark.parametrize(
    ("query", "status", "words"),
    [
        ("below=topics", 400, "begin it with a slash"),
        ("below=/&part=-1", 400, "number of a part"),
        ("part=1e9", 400, "number of a part"),
        ("below=/&part=9999", 404, "there are"),
        ("below=/nothing/", 404, "/nothing/"),
    ],
)
@pytest.mark.parametrize("path", ["/openapi.json", "/.well-known/wot"])
def test_a_part_that_there_is_not_is_refused_in_words(
    path: str, query: str, status: int, words: str, http: httpx.Client
) -> None:
    answer = http.get(f"{path}?{query}", headers=TD if path != "/openapi.json" else {})
    assert answer.status_code == status
    assert words in answer.text


def test_a_part_has_an_entity_tag_of_its_own(http: httpx.Client) -> None:
    whole, part = http.get("/openapi.json"), http.get("/openapi.json?below=/topics/")
    assert whole.headers["etag"] != part.headers["etag"]
    again = http.get("/openapi.json?below=/topics/", headers={"If-None-Match": part.headers["etag"]})
    assert again.status_code == 304


@pytest.mark.parametrize("which", ["many", "flat"])
@pytest.mark.parametrize("path", ["/.well-known/wot", "/resources/"])
def test_the_parts_of_a_thing_description_are_small_and_tell_all_of_it(
    path: str, which: str, request: pytest.FixtureRequest
) -> None:
    http: httpx.Client = request.getfixturevalue(which)
    whole = http.get(path, headers=TD).json()
    parts = list(things(http, section(whole)))
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


def test_a_small_thing_description_has_no_parts_to_link_to(http: httpx.Client) -> None:
    links = http.get("/.well-known/wot", headers=TD).json()["links"]
    assert {link["rel"] for link in links} == {"item"}


_NAMES = st.text("abc/", min_size=1, max_size=5)


@given(
    st.dictionaries(_NAMES, st.integers(0, 40_000), max_size=12),
    st.dictionaries(st.sampled_from("xyz"), st.integers(0, 20_000)),
    st.data(),
)
def test_every_path_is_in_one_part_with_all_that_it_refers_to(
    paths: dict[str, int], schemas: dict[str, int], data: st.DataObject
) -> None:
    whole: dict[str, Any] = {
        "info": {},
        "tags": [{"name": "room"}],
        "x-parts": [],
        "paths": {
            f"/{name}": {
                "get": {"tags": ["room"], "is": "a" * size},
                "put": {"$ref": f"#/components/schemas/{data.draw(st.sampled_from('xyz'))}"},
            }
            for name, size in paths.items()
        },
        "components": {"schemas": {name: {"is": "b" * size} for name, size in schemas.items()}},
    }
    below = data.draw(_NAMES.map("/{}".format) | st.just("/"))
    found = description_parts(orjson.dumps(whole), "http://127.0.0.1/openapi.json", below)
    assert all(len(part) <= MAX_PART for part in found)
    parts = [orjson.loads(part) for part in found]
    wanted = {path: item for path, item in whole["paths"].items() if path.startswith(below)}
    assert [path for part in parts for path in part["paths"]] == list(wanted)
    for part in parts:
        assert part["paths"].items() <= wanted.items()
        named = {item["put"]["$ref"].rpartition("/")[2] for item in part["paths"].values()}
        assert set(part["components"].get("schemas", {})) == named & set(schemas)


def test_the_entry_leads_to_a_guide_for_language_models_whose_links_lead_on(http: httpx.Client) -> None:
    guide = http.get(http.get("/", headers={"Accept": "application/json"}).links["help"]["url"])
    assert guide.headers["content-type"] == "text/plain; charset=utf-8"
    title, _, summary = guide.text.splitlines()[:3]
    assert title.startswith("# ")
    assert summary.startswith("> ")
    urls = re.findall(r"\]\((\S+?)\)", guide.text)
    assert "/find?" in urls[0]
    assert "/queries/what-can-be-done" in urls[1]
    for url in urls:
        assert http.get(url).status_code in (200, 400), url  # SPARQL wants a query
    assert len(guide.content) < 3000


def test_the_guide_of_a_read_only_robot_offers_no_writes(serve: Callable[..., Served]) -> None:
    guide = serve("aircraft", "--read-only").http.get("/llms.txt").text
    assert "read-only" in guide
    assert "PUT" not in guide
