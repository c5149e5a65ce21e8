"""Parameters as declared by their nodes (ROS 2), over HTTP: read-only, of one type, within a range, described."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import Any

import httpx
import pyshacl
import pytest
import rdflib
from msgspec.structs import replace
from rdflib.namespace import SH

from rosld.adapters.model import Descriptor, ParameterType, Range
from tests.server.robots.made_up import MadeUp, served

ROS = rdflib.Namespace("https://w3id.org/rosld#")
JSON = {"accept": "application/json"}
MERGE = {"content-type": "application/merge-patch+json"}
TURTLE = {"content-type": "text/turtle"}
DECLARED = {
    "/lamp/level": (5, Descriptor(ParameterType.INTEGER, "How bright it is.", range=Range(0, 20, 5))),
    "/lamp/gain": (0.5, Descriptor(ParameterType.DOUBLE, constraints="Not too loud.", range=Range(0.0, 1.0, 0.1))),
    "/lamp/serial": ("A7", Descriptor(ParameterType.STRING, read_only=True)),
    "/lamp/free": (1, Descriptor(dynamic_typing=True)),
    "/lamp/name": ("Ada", Descriptor(ParameterType.STRING)),
    "/lamp/known": (1, None),
}


@pytest.fixture(scope="module")
def serving_lamp() -> Iterator[tuple[MadeUp, httpx.Client]]:
    robot = MadeUp()
    robot.capabilities = replace(robot.capabilities, parameter_trees=False)
    robot.owners = ("/lamp",)
    with served(robot) as client:
        yield robot, client


@pytest.fixture
def lamp(serving_lamp: tuple[MadeUp, httpx.Client]) -> MadeUp:
    """The lamp in its initial state."""
    robot, _ = serving_lamp
    robot.declared = {name: descriptor for name, (_, descriptor) in DECLARED.items() if descriptor is not None}
    for name, (value, _) in DECLARED.items():
        robot.parameter(name, value)
    robot.sets.clear()
    return robot


@pytest.fixture
def client(lamp: MadeUp, serving_lamp: tuple[MadeUp, httpx.Client]) -> httpx.Client:
    return serving_lamp[1]


def graph(client: httpx.Client, path: str) -> rdflib.Graph:
    return rdflib.Graph().parse(data=client.get(path, headers={"accept": "application/n-triples"}).text, format="nt")


def report(answer: httpx.Response) -> tuple[rdflib.Graph, Any]:
    """Return the validation report of a refusal, and its single result."""
    found = rdflib.Graph().parse(data=answer.text, format="turtle")
    (result,) = found.objects(None, SH.result)
    return found, result


def test_a_parameter_says_what_is_declared_of_it_by_a_shape_that_judges_it(client: httpx.Client) -> None:
    answer = client.get("/parameters/lamp/level", headers={"accept": "text/turtle"})
    url = str(answer.url)
    assert f'<{url}?shape>; rel="http://www.w3.org/ns/ldp#constrainedBy"' in answer.headers["link"]
    found = graph(client, "/parameters/lamp/level")
    subject, shape = rdflib.URIRef(url), rdflib.URIRef(f"{url}#constraint")
    assert str(found.value(subject, rdflib.DCTERMS.description)) == "How bright it is."
    assert str(found.value(subject, ROS.parameterType)) == "integer"
    assert found.value(subject, ROS.readOnly).toPython() is False  # type: ignore[union-attr]
    assert found.value(shape, SH.targetNode) == subject
    assert client.get("/parameters/lamp/level", headers=JSON).json() == 5
    assert list(graph(client, "/parameters/lamp/serial").objects(None, ROS.readOnly)) == [rdflib.Literal(True)]
    undeclared = client.get("/parameters/lamp/known", headers={"accept": "text/turtle"})
    assert "readOnly" not in undeclared.text
    assert "/parameters/lamp/known?shape>" in undeclared.headers["link"]
    for value, good in ((5, True), (20, True), (25, False), (7, False)):
        found.set((subject, ROS.value, rdflib.Literal(value)))
        assert pyshacl.validate(found, shacl_graph=found)[0] is good, value


def test_allow_forms_and_openapi_tell_the_truth(client: httpx.Client) -> None:
    described = client.get("/openapi.json").json()
    for name, methods in (
        ("level", {"PUT", "PATCH"}),
        ("serial", set()),
        ("free", {"PUT", "PATCH", "DELETE"}),
        ("known", {"PUT", "PATCH", "DELETE"}),
    ):
        path = f"/parameters/lamp/{name}"
        allowed = set(client.options(path).headers["allow"].split(", "))
        assert allowed == {"GET", "HEAD", "OPTIONS"} | methods
        shown = client.get(path, headers={"accept": "text/html"}).text
        for method in ("PUT", "DELETE"):
            assert (f'name="method" value="{method}"' in shown) is (method in methods)
        item = described["paths"][path]
        assert {verb for verb in item if verb in ("put", "patch", "delete")} == set(map(str.lower, methods))


MISFITS = (
    ("level", -5, SH.MinInclusiveConstraintComponent, "must be at least 0, not -5"),
    ("level", 25, SH.MaxInclusiveConstraintComponent, "must be at most 20, not 25"),
    ("level", 7, ROS.StepConstraintComponent, "0 and steps of 5 from there, up to 20"),
    ("level", 7.5, SH.DatatypeConstraintComponent, "is declared as integer, which 7.5 is not"),
    ("gain", 1.01, SH.MaxInclusiveConstraintComponent, "must be at most 1.0, not 1.01"),
    ("name", 4, SH.DatatypeConstraintComponent, "is declared as string, which 4 is not"),
    ("name", {"a": 4}, SH.DatatypeConstraintComponent, "is declared as string"),
)


def test_what_does_not_fit_is_refused_with_the_report_of_the_shape_before_anything_is_sent(
    lamp: MadeUp, client: httpx.Client
) -> None:
    for path, value, component, words in MISFITS:
        answer = client.put(f"/parameters/lamp/{path}", json=value, headers={"accept": "text/turtle"})
        assert answer.status_code == 422
        found, result = report(answer)
        assert words in str(found.value(result, SH.resultMessage))
        assert found.value(result, SH.sourceConstraintComponent) == component
        assert found.value(result, SH.focusNode) == rdflib.URIRef(str(answer.url))
        assert found.value(result, SH.sourceShape) == rdflib.URIRef(f"{answer.url}#constraint.value")
        detail = client.put(f"/parameters/lamp/{path}", json=value).json()["detail"]
        assert f"/lamp/{path}: " in detail
        assert words in detail
    assert lamp.sets == []


def test_rdf_is_judged_as_json_is_and_what_was_read_can_be_put_back(lamp: MadeUp, client: httpx.Client) -> None:
    update = {"content-type": "application/sparql-update"}
    patch = f"DELETE {{ <> <{ROS.value}> ?old }} INSERT {{ <> <{ROS.value}> 3 }} WHERE {{ <> <{ROS.value}> ?old }}"
    said = f'<> <{ROS.value}> 21 ; <{ROS.readOnly}> true ; <http://purl.org/dc/terms/description> "Mine." .'
    assert client.put("/parameters/lamp/level", content=said, headers=TURTLE).status_code == 422
    assert client.patch("/parameters/lamp/level", content=patch, headers=update).status_code == 422
    assert lamp.sets == []
    text = client.get("/parameters/lamp/level", headers={"accept": "text/turtle"}).text
    assert client.put("/parameters/lamp/level", content=text, headers=TURTLE).status_code == 204
    assert client.put("/parameters/lamp/level", content=said.replace("21", "15"), headers=TURTLE).status_code == 204
    assert client.patch("/parameters/lamp/level", content=patch.replace("> 3", "> 10"), headers=update).is_success
    assert [each["/lamp/level"] for each in lamp.sets] == [5, 15, 10]
    assert "How bright it is." in client.get("/parameters/lamp/level").text


def test_a_read_only_parameter_is_not_written_in_any_way_nor_part_of_an_update(
    lamp: MadeUp, client: httpx.Client
) -> None:
    for root in ("parameters", "resources"):
        refused = client.put(f"/{root}/lamp/serial", json="B8")
        assert refused.status_code == 405
        assert "/lamp/serial is read-only" in refused.json()["detail"]
    assert client.delete("/parameters/lamp/serial").status_code == 405
    for names, value, words in (
        ("</parameters/lamp/serial>", "'B8'", "/lamp/serial is read-only"),
        ("</parameters/lamp/level> </parameters/lamp/gain>", 20, "must be at most 1.0, not 20"),
    ):
        old = f"GRAPH ?p {{ ?p <{ROS.value}> ?v }}"
        new = old.replace("?v", str(value))
        update = f"DELETE {{ {old} }} INSERT {{ {new} }} WHERE {{ VALUES ?p {{ {names} }} {old} }}"
        answer = client.post("/sparql", content=update, headers={"content-type": "application/sparql-update"})
        assert 400 <= answer.status_code < 500
        assert words in answer.text
    assert lamp.sets == []


def test_a_patch_of_several_is_refused_whole_and_leaves_what_is_read_only_as_it_is(
    lamp: MadeUp, client: httpx.Client
) -> None:
    for patch, status, words in (
        ({"level": 10, "gain": 2}, 422, "/lamp/gain: must be at most 1.0, not 2"),
        ({"level": 10, "serial": "B8"}, 409, "/lamp/serial is read-only"),
        ({"level": 10, "name": None}, 409, "/lamp/name cannot be deleted"),
        ({"level": 10, "gain": "high"}, 422, "/lamp/gain: is declared as double"),
    ):
        answer = client.patch("/parameters/lamp/", json=patch, headers=MERGE)
        assert answer.status_code == status
        assert words in answer.json()["detail"]
    assert lamp.sets == []
    whole = client.get("/parameters/lamp/", headers=JSON).json()
    assert whole["level"] == 5
    assert client.patch("/parameters/lamp/", json=whole | {"level": 10, "free": None}, headers=MERGE).status_code == 204
    assert lamp.sets == [{"/lamp/level": 10}]
    assert client.get("/parameters/lamp/free").status_code == 404


def test_a_property_of_a_parameter_offers_what_is_declared_and_conforms_to_its_shape(
    lamp: MadeUp, client: httpx.Client
) -> None:
    thing = client.get("/resources/lamp/?format=td").json()["properties"]
    level, serial = thing["level"], thing["serial"]
    told = {"type": "integer", "minimum": 0, "maximum": 20, "multipleOf": 5, "readOnly": False}
    assert told.items() <= level.items()
    assert level["description"] == "How bright it is."
    assert serial["readOnly"] is True
    assert {one["op"] for one in serial["forms"]} == {"readproperty"}
    assert client.get("/.well-known/wot").json()["properties"]["lamp/gain"]["maximum"] == 1.0
    found = graph(client, "/resources/lamp/level")
    (shape,) = found.subjects(rdflib.RDF.type, SH.NodeShape)
    (subject,) = found.subjects(rdflib.RDF.type, ROS.Property)
    found.add((shape, SH.targetNode, subject))
    assert pyshacl.validate(found, shacl_graph=found)[0] is True
    found.set((subject, rdflib.RDF.value, rdflib.Literal(25)))
    assert pyshacl.validate(found, shacl_graph=found)[0] is False
    assert client.put("/resources/lamp/level", json=25).status_code == 422
    assert lamp.sets == []
    assert client.put("/resources/lamp/level", json=15).status_code == 204


def test_the_form_shows_the_words_as_text_and_the_bounds(lamp: MadeUp, client: httpx.Client) -> None:
    lamp.declared["/lamp/level"] = dataclasses.replace(lamp.declared["/lamp/level"], description="<script>\x00")
    lamp.parameter("/lamp/level", 5)
    for path in ("/parameters/lamp/level", "/resources/lamp/level"):
        page = client.get(path, headers={"accept": "text/html"}).text
        assert "<p>&lt;script&gt;" in page
        assert "\x00" not in page
        assert 'min="0" max="20" step="5"' in page
        assert "From 0 to 20, in steps of 5." in page


def test_a_form_that_does_not_fit_comes_back_with_the_reason(lamp: MadeUp, client: httpx.Client) -> None:
    page = client.get("/parameters/lamp/gain", headers={"accept": "text/html"}).text
    assert "Not too loud." in page
    form = page[page.index('<section class="form value"') :]
    token = form.split('name="csrf" value="')[1].split('"')[0]
    sent = {"csrf": token, "method": "PUT", "value": "3"}
    answer = client.post("/parameters/lamp/gain", data=sent, headers={"accept": "text/html"})
    assert answer.status_code == 422
    assert "must be at most 1.0, not 3" in answer.text
    assert lamp.sets == []
    assert client.post("/parameters/lamp/gain", data=sent | {"value": "0.3"}).status_code == 303
    assert lamp.sets == [{"/lamp/gain": 0.3}]


def test_queries_find_what_is_read_only_without_asking_for_values(lamp: MadeUp, client: httpx.Client) -> None:
    lamp.reads.clear()
    query = "SELECT ?name WHERE { ?p ros:readOnly true ; ros:name ?name }"
    found = client.get("/sparql", params={"query": query}, headers={"accept": "text/csv"}).text
    assert found.split() == ["name", "/lamp/serial"]
    query = """SELECT ?name ?least ?greatest WHERE {
        ?p ros:name ?name ; ros:shape/sh:property [ sh:minInclusive ?least ; sh:maxInclusive ?greatest ] }"""
    found = client.get("/sparql", params={"query": query}, headers={"accept": "text/csv"}).text
    assert set(found.split()[1:]) == {"/lamp/level,0,20", "/lamp/gain,0.0,1.0"}
    assert not lamp.reads


def test_what_is_declared_anew_is_told_anew(lamp: MadeUp, client: httpx.Client) -> None:
    before = client.get("/parameters/lamp/level")
    lamp.declared["/lamp/level"] = Descriptor(ParameterType.INTEGER, range=Range(0, 9))
    lamp.parameter("/lamp/level", 5)
    after = client.get("/parameters/lamp/level")
    assert before.headers["etag"] != after.headers["etag"]
    assert client.put("/parameters/lamp/level", json=9).status_code == 204
