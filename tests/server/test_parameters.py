"""Parameters over HTTP: create, read, update, delete (paper, Table 2)."""

from __future__ import annotations

import httpx
import pytest

ROS = "https://w3id.org/rosld#"
JSON = {"Accept": "application/json"}


@pytest.fixture
def plane(own_aircraft: httpx.Client) -> httpx.Client:
    """An aircraft of this test's own."""
    return own_aircraft


@pytest.mark.parametrize("value", [True, 7, -1.5, "text", "", [1, 2.5, "x", [True]], "\u00e9\n\"'<", {"a": {"b": 1}}])
def test_a_parameter_is_created_read_updated_and_deleted(plane: httpx.Client, value: object) -> None:
    url = "/parameters/test/value"
    assert plane.get(url).status_code == 404
    created = plane.put(url, json=value)
    assert created.status_code == 201, created.text
    assert plane.get(created.headers["location"], headers=JSON).json() == value
    assert plane.put(url, json="other").status_code in (204, 409)
    assert plane.delete(created.headers["location"]).status_code == 204
    assert plane.get(created.headers["location"]).status_code == 404


@pytest.mark.parametrize("query", ["at=-5", "timemap", "series=value"])
def test_a_parameter_has_no_past_and_says_so(plane: httpx.Client, query: str) -> None:
    assert plane.put("/parameters/p", json=4).status_code == 201
    answer = plane.get(f"/parameters/p?{query}", headers=JSON)
    assert answer.status_code == 404, "the present value is no answer to what it was"
    assert "nothing records the values of parameters" in answer.json()["detail"]


def test_rdf_and_json_set_the_same(plane: httpx.Client) -> None:
    turtle = f"<> <{ROS}value> 4.5 ."
    assert plane.put("/parameters/p", content=turtle, headers={"Content-Type": "text/turtle"}).status_code == 201
    assert plane.get("/parameters/p", headers=JSON).json() == 4.5
    assert f"{ROS}value" in plane.get("/parameters/p", headers={"Accept": "application/n-triples"}).text


def test_what_was_read_can_be_put_back(plane: httpx.Client) -> None:
    for value in (3, 2.5, "x", [1, "a"], True):
        plane.put("/parameters/p", json=value)
        turtle = plane.get("/parameters/p", headers={"Accept": "text/turtle"}).content
        answer = plane.put("/parameters/p", content=turtle, headers={"Content-Type": "text/turtle"})
        assert answer.status_code == 204, answer.text
        assert plane.get("/parameters/p", headers=JSON).json() == value


def test_a_tree_is_a_container_and_its_json_is_the_object_of_its_members(plane: httpx.Client) -> None:
    plane.put("/parameters/tree/a", json=1)
    plane.put("/parameters/tree/deep/b", json="two")
    assert plane.get("/parameters/tree/", headers=JSON).json() == {"a": 1, "deep": {"b": "two"}}
    turtle = plane.get("/parameters/tree/", headers={"Accept": "application/n-triples"})
    assert "ldp#contains" in turtle.text
    assert "ldp#BasicContainer" in turtle.headers["link"]
    assert plane.delete("/parameters/tree/").status_code == 204
    assert plane.get("/parameters/tree/a").status_code == 404


def test_post_to_a_tree_creates_a_member_named_by_slug(plane: httpx.Client) -> None:
    plane.put("/parameters/tree/a", json=1)
    made = plane.post("/parameters/tree/", json=5, headers={"Slug": "fresh"})
    assert made.status_code == 201
    assert made.headers["location"].endswith("/parameters/tree/fresh")
    again = plane.post("/parameters/tree/", json=6, headers={"Slug": "fresh"})
    assert again.headers["location"] != made.headers["location"]


def test_merge_patch_of_a_tree_sets_and_deletes(plane: httpx.Client) -> None:
    plane.put("/parameters/tree", json={"a": 1, "b": 2, "c": 3})
    headers = {"Content-Type": "application/merge-patch+json"}
    assert plane.patch("/parameters/tree/", content='{"a": 10, "b": null}', headers=headers).status_code == 204
    assert plane.get("/parameters/tree/", headers=JSON).json() == {"a": 10, "c": 3}


def test_a_patch_takes_away_what_a_client_spells_otherwise(plane: httpx.Client) -> None:
    said = {1: ("01", "integer"), 2.5: ("2.50e0", "double"), False: ("0", "boolean")}
    for value, (spelt, datatype) in said.items():
        plane.put("/parameters/p", json=value)
        old = f'<> ros:value "{spelt}"^^<http://www.w3.org/2001/XMLSchema#{datatype}>'
        ros = "PREFIX ros: <https://w3id.org/rosld#>"
        update = f"{ros} DELETE DATA {{ {old} }} ; INSERT DATA {{ <> ros:value 'new' }}"
        patched = plane.patch("/parameters/p", content=update, headers={"Content-Type": "application/sparql-update"})
        assert patched.status_code == 204, patched.text
        assert plane.get("/parameters/p", headers=JSON).json() == "new"


def test_a_value_never_wipes_out_others_unasked(plane: httpx.Client) -> None:
    plane.put("/parameters/tree/a", json=1)
    assert plane.put("/parameters/tree", json=5).status_code == 409
    assert plane.put("/parameters/tree/a/below", json=5).status_code == 409
    assert plane.get("/parameters/tree/", headers=JSON).json() == {"a": 1}


def test_if_match_guards_a_parameter(plane: httpx.Client) -> None:
    plane.put("/parameters/p", json=1)
    etag = plane.get("/parameters/p").headers["etag"]
    assert plane.put("/parameters/p", json=2, headers={"If-Match": etag}).status_code == 204
    assert plane.put("/parameters/p", json=3, headers={"If-Match": etag}).status_code == 412
    assert plane.put("/parameters/p", json=3, headers={"If-None-Match": "*"}).status_code == 412
    assert plane.get("/parameters/p", headers=JSON).json() == 2


def test_null_is_no_value(plane: httpx.Client) -> None:
    answer = plane.put("/parameters/p", content="null", headers={"Content-Type": "application/json"})
    assert answer.status_code == 422
    assert plane.get("/parameters/p").status_code == 404
