"""`/openapi.json`: valid OpenAPI 3.1, and consistent with the responses of the server."""

from __future__ import annotations

import re
from collections.abc import Iterator
from itertools import cycle
from typing import Any

import httpx
import pytest
from openapi_spec_validator import OpenAPIV31SpecValidator

from rosld.adapters.base import AdapterOptions
from rosld.adapters.registry import adapter_for
from rosld.server.app import create_app
from rosld.server.resources.entry_point import FILES
from rosld.server.settings import Settings
from tests.crawl.description import inlined
from tests.server.robots.made_up import served

pytestmark = pytest.mark.slow

METHODS = {"get", "put", "post", "patch", "delete"}
SAMPLES = {
    "package": "std_msgs",
    "kind": "msg",
    "name": "String",
    "path": "described",
    "folder": "how-to",
    "page": "ros1",
}


def described(http: httpx.Client) -> dict[str, Any]:
    answer = http.get("/openapi.json")
    assert answer.status_code == 200, answer.text
    found: dict[str, Any] = answer.json()
    return found


HAS_PROVENANCE = "http://www.w3.org/ns/prov#has_provenance"


def places(description: dict[str, Any], http: httpx.Client) -> Iterator[tuple[str, set[str]]]:
    """Yield every path, with segments in place of the template's names, and its described methods."""
    called = http.post("/services/aircraft/get_power")
    made = {"/calls/{id}": httpx.URL(called.headers["location"]).path}
    made["/activity/{id}"] = httpx.URL(called.links[HAS_PROVENANCE]["url"]).path
    goal = http.post("/actions/aircraft/fly", json={"distance": -1})  # rejected, and stored
    made["/goals/{id}"] = httpx.URL(goal.headers["location"]).path
    made |= {"/holds/{id}": "/holds/any", "/faults/{id}": "/faults/any"}
    for kind in ("WebSocketChannel2023", "StreamingHTTPChannel2023"):
        channel = httpx.URL(subscribed(http, kind).headers["location"]).path
        made[f"/channels/{kind}/{{token}}"] = channel
        made[f"/channels/{kind}/{{token}}/messages"] = f"{channel}/messages"
    for path in description["paths"]:
        at = made.get(path) or re.sub(r"\{(\w+)\}", lambda name: SAMPLES[name[1]], path)
        methods = {method.upper() for method in description["paths"][path].keys() & METHODS}
        yield at, methods | ({"HEAD", "OPTIONS"} if "GET" in methods else {"OPTIONS"})


def subscribed(http: httpx.Client, kind: str) -> httpx.Response:
    """Return the response to a request for a channel."""
    notify = "https://www.w3.org/ns/solid/notifications"
    wish = {"@context": [f"{notify}-context/v1"], "type": f"{notify.replace('https', 'http')}#{kind}"}
    answer = http.post(f"/channels/{kind}", json={**wish, "topic": str(http.base_url.join("/topics/"))})
    assert answer.status_code == 201, answer.text
    return answer


def disagreements(http: httpx.Client) -> dict[str, tuple[set[str], set[str]]]:
    """Return the paths whose description differs from OPTIONS, with both."""
    found = {}
    for path, methods in places(described(http), http):
        answer = http.options(path)
        assert answer.status_code == 204, (path, answer.text)
        allowed = set(answer.headers["allow"].split(", "))
        if path.endswith("/described"):
            allowed |= (
                {"GET", "HEAD", "POST", "PATCH", "DELETE"} if "PUT" in allowed else set()
            )  # resources that may appear there
        if path in ("/queries/String", "/shapes/String") and "PUT" in allowed:
            allowed |= {"DELETE"} if path.startswith("/queries/") else {"DELETE", "PATCH"}
        if path.startswith("/resources/") and http.get(path).status_code == 404:  # it is not on offer now
            assert allowed <= methods - {"GET", "HEAD"}
            continue
        if path.startswith("/topics/") and "PUT" in allowed:
            allowed |= {"DELETE"}  # allowed once something was published
        if "GET" in methods - allowed and http.get(path).status_code == 404:  # future resources are described
            if allowed == {"OPTIONS"}:  # not by a write to its URL
                continue
            allowed |= {"GET", "HEAD"}
        if allowed != methods:
            found[path] = (methods, allowed)
    return found


def test_the_description_is_valid_openapi(http: httpx.Client) -> None:
    OpenAPIV31SpecValidator(described(http)).validate()


def test_each_path_is_told_to_answer_what_its_options_say(http: httpx.Client) -> None:
    assert not disagreements(http)


def test_every_room_of_the_server_is_described(http: httpx.Client) -> None:
    application = create_app(adapter_for("aircraft", AdapterOptions()), Settings())
    rooms = {path.split("/")[1] for path in described(http)["paths"]}
    assert application.rooms - FILES.keys() - {"body"} == rooms, "the aircraft has no robot_description"
    assert {"/.well-known/solid", "/.well-known/wot"} <= described(http)["paths"].keys()


def test_what_can_be_followed_or_comes_in_pages_is_told_and_nothing_else(http: httpx.Client) -> None:
    description = described(http)
    turtle, stream = {"Accept": "text/turtle"}, {"Accept": "text/event-stream"}
    small = {"Prefer": "return=representation; max-member-count=1", **turtle}
    waiting = {"after", "timeout", "rate"}
    wrong = []
    for item, (path, _) in zip(inlined(description).values(), places(description, http), strict=True):
        told = {one["name"] for one in item.get("get", {}).get("parameters", ()) if one["in"] == "query"}
        answer = http.head(path, headers=stream)
        if answer.status_code == 404 or path == "/space":  # its stream takes none of these
            continue
        streams = answer.headers.get("content-type", "").startswith("text/event-stream")
        is_query = path.startswith("/queries/") and not path.endswith("/")  # with a timeout of its own
        if waiting & (told - {"timeout"} if is_query else told) != (waiting if streams else set()):
            wrong.append((path, streams, told))
        if "after" in told and (answer := http.get(path, headers=turtle)).status_code == 200:
            asked = {"after": answer.headers["etag"], "timeout": 0}
            later = http.get(path, params=asked, headers=turtle)
            assert later.status_code == 304 or later.headers["etag"] != asked["after"], path
        if path.endswith("/") and path in description["paths"]:
            assert "page" in told or http.get(path, headers=small).status_code != 303, path
    assert not wrong


def test_a_read_only_server_describes_reading_only_and_refuses_what_others_describe(http: httpx.Client) -> None:
    with served(adapter_for("aircraft", AdapterOptions()), read_only=True) as closed:
        description = described(closed)
        methods = {
            method
            for path in description["paths"]
            for method in description["paths"][path].keys() & METHODS
            if path != "/sparql" and not path.startswith("/channels/")  # reads and streams write nothing
        }
        assert methods == {"get"}
        wrong = []
        for path, method in zip(described(http)["paths"], cycle(("PUT", "POST", "PATCH", "DELETE"))):
            at = re.sub(r"\{(\w+)\}", lambda name: SAMPLES.get(name[1], "any"), path)
            allowed = closed.options(at).headers.get("allow", "").split(", ")
            answer = closed.request(method, at, content="<> <urn:p> 1 .", headers={"Content-Type": "text/turtle"})
            if method not in allowed and not 400 <= answer.status_code < 500:
                wrong.append((method, at, answer.text))
        assert not wrong, wrong
        names = ("/mappings/aircraft", "/queries/mine", "/queries/inventory", "/shapes/slow", "/shapes/limits")
        for at in (*names, "/mappings/", "/queries/", "/shapes/"):
            answer = closed.request("POST" if at.endswith("/") else "PUT", at, content="# A.\nASK {}", headers=QUERY)
            assert answer.status_code == 405, at
            assert answer.json()["detail"] == "This server is read-only."
            assert answer.headers["allow"] in ("OPTIONS", "GET, HEAD, OPTIONS")
        assert closed.get("/queries/inventory", headers={"Accept": "text/csv"}).status_code == 200


QUERY = {"Content-Type": "application/sparql-query"}


def test_the_description_is_the_same_until_the_robot_changes(http: httpx.Client) -> None:
    first = http.get("/openapi.json")
    assert http.get("/openapi.json").content == first.content
    assert http.get("/openapi.json", headers={"If-None-Match": first.headers["etag"]}).status_code == 304
    http.put("/parameters/described_anew", json=1)
    try:
        assert "/parameters/described_anew" in described(http)["paths"]
    finally:
        http.delete("/parameters/described_anew")
    assert http.get("/openapi.json").content == first.content


def test_the_entry_links_to_the_description_which_has_two_media_types(http: httpx.Client) -> None:
    links = http.get("/", headers={"Accept": "text/turtle"}).headers["link"]
    assert f'<{http.base_url}openapi.json>; rel="service-desc"; type="application/openapi+json"' in links
    assert "service-desc" in http.options("/").headers["link"]
    for media_type in ("application/json", "application/openapi+json"):
        answer = http.get("/openapi.json", headers={"Accept": media_type})
        assert answer.status_code == 200
        assert answer.headers["content-type"] == media_type
    assert http.get("/openapi.json", headers={"Accept": "text/turtle"}).status_code == 406
