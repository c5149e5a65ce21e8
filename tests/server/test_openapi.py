"""`/openapi.json`: valid OpenAPI 3.1, and true: what it tells of methods is what the server answers."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from typing import Any

import httpx
import pytest
from openapi_spec_validator import OpenAPIV31SpecValidator

from rosld.server.ldp.resource import READ
from rosld.server.ldp.verbs import OFFERS
from rosld.server.openapi import json_schema
from rosld.server.openapi.description import description
from rosld.server.openapi.place import Place

METHODS = {"get", "head", "options", "put", "post", "patch", "delete"}
SAMPLES = {"package": "std_msgs", "kind": "msg", "name": "String", "path": "described"}


def described(http: httpx.Client) -> dict[str, Any]:
    answer = http.get("/openapi.json")
    assert answer.status_code == 200, answer.text
    found: dict[str, Any] = answer.json()
    return found


def path_item(description: dict[str, Any], path: str) -> dict[str, Any]:
    """The Path Item of a path, where it stands or where it is referred to."""
    item: dict[str, Any] = description["paths"][path]
    if "$ref" in item:
        item = description["components"]["pathItems"][item["$ref"].rpartition("/")[2]]
    return item


def places(description: dict[str, Any], http: httpx.Client) -> Iterator[tuple[str, set[str]]]:
    """Every path, with segments where the template has names, and the methods it is told to answer."""
    call = httpx.URL(http.post("/services/aircraft/get_power").headers["location"]).path
    for path in description["paths"]:
        at = call if path == "/calls/{id}" else re.sub(r"\{(\w+)\}", lambda name: SAMPLES[name[1]], path)
        yield at, {method.upper() for method in path_item(description, path).keys() & METHODS}


def disagreements(http: httpx.Client) -> dict[str, tuple[set[str], set[str]]]:
    """The paths of which the description says something else than OPTIONS: what it says, what they say."""
    found = {}
    for path, methods in places(described(http), http):
        answer = http.options(path)
        assert answer.status_code == 204, (path, answer.text)
        allowed = set(answer.headers["allow"].split(", "))
        if path.endswith("/described"):
            allowed |= {"GET", "POST", "PATCH", "DELETE"} if "PUT" in allowed else set()  # what may come to be there
        if allowed != methods:
            found[path] = (methods, allowed)
    return found


def test_the_description_is_valid_openapi(http: httpx.Client) -> None:
    OpenAPIV31SpecValidator(described(http)).validate()


def test_the_entry_links_to_the_description(http: httpx.Client) -> None:
    links = http.get("/", headers={"Accept": "text/turtle"}).headers["link"]
    assert f'<{http.base_url}openapi.json>; rel="service-desc"; type="application/openapi+json"' in links
    assert "service-desc" in http.options("/").headers["link"]


def test_each_path_is_told_to_answer_what_its_options_say(http: httpx.Client) -> None:
    assert not disagreements(http)


def test_a_read_only_server_describes_reading_only(serve: Callable[..., Any]) -> None:
    http = serve("aircraft", "--read-only").http
    description = described(http)
    methods = {
        method
        for path in description["paths"]
        for method in path_item(description, path).keys() & METHODS
        if path != "/sparql"
    }
    assert methods == {"get", "head", "options"}


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


@pytest.mark.parametrize("media_type", ["application/json", "application/openapi+json"])
def test_the_description_is_had_by_either_of_its_names(http: httpx.Client, media_type: str) -> None:
    answer = http.get("/openapi.json", headers={"Accept": media_type})
    assert answer.status_code == 200
    assert answer.headers["content-type"] == media_type
    assert http.get("/openapi.json", headers={"Accept": "text/turtle"}).status_code == 406


def test_messages_are_described_by_the_schemas_of_their_types(http: httpx.Client) -> None:
    description = described(http)
    put = path_item(description, "/topics/cockpit/display")["put"]
    assert put["requestBody"]["content"]["application/json"]["schema"] == {
        "$ref": "#/components/schemas/std_msgs.msg.String"
    }
    assert description["components"]["schemas"]["std_msgs.msg.String"] == {
        "type": "object",
        "properties": {"data": {"type": "string"}},
        "required": ["data"],
    }


def test_the_parameters_of_a_stored_query_are_told_with_their_types(http: httpx.Client) -> None:
    parameters = path_item(described(http), "/queries/silent-topics")["get"]["parameters"]
    told = {one["name"]: one["schema"] for one in parameters if one.get("in") == "query" and one["name"] != "format"}
    assert told == {"seconds": {"type": "number"}}


def test_what_only_the_server_says_is_not_to_be_sent() -> None:
    elided = {"type": "object", "readOnly": True}
    schema: json_schema.Schema = {
        "type": "object",
        "properties": {"unit": {"oneOf": [{"type": "array"}, elided]}, "speed": {"type": "number", "unit": "u"}},
        "required": ["unit", "speed"],
    }
    assert json_schema.as_sent(schema) == {
        "type": "object",
        "properties": {"unit": {"type": "array"}, "speed": {"type": "number", "x-unit": "u"}},
        "required": ["unit", "speed"],
    }
    assert json_schema.as_patch(schema)["properties"] == json_schema.as_sent(schema)["properties"]
    assert "required" not in json_schema.as_patch(schema)


def test_places_come_in_the_order_of_their_paths_and_operations_have_names_of_their_own() -> None:
    paths = ["/b/x_y", "/b/x/y", "/a/", "/a"]
    given = [Place(path, "room", path, READ, OFFERS) for path in paths]
    first = description("t", "http://127.0.0.1/", "1", "a", given, {})
    assert first == description("t", "http://127.0.0.1/", "1", "a", reversed(given), {})
    assert [path.encode() in first for path in paths] == [True] * 4
    names = re.findall(rb'"operationId":"([^"]+)"', first)
    assert len(names) == len(set(names)) == 12
