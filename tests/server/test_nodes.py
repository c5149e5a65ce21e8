"""Nodes over HTTP: the topics, services and actions of each, and the transitions of a managed one."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import httpx
import pytest
from pyoxigraph import NamedNode, Triple

from rosld.adapters.model import Lifecycle, Sent, TimedOut, Unreachable
from rosld.ontology.vocab import hctl, htv, rdf, ros, sh, td
from tests.server.robots.made_up import served
from tests.server.robots.managed import Managed, standing

pytestmark = pytest.mark.slow

TRIPLES = {"Accept": "application/n-triples"}
PROBLEM = {"Accept": "application/problem+json"}


@pytest.fixture
def camera() -> Managed:
    """A robot with a managed node."""
    return Managed()


@pytest.fixture
def http(camera: Managed) -> Iterator[httpx.Client]:
    """A client of it."""
    with served(camera) as client:
        yield client


@pytest.fixture
def said(triples_of: Callable[[httpx.Response], set[Triple]]) -> Callable[..., list[str]]:
    """Return the objects of a predicate of a node, or of a fragment, in the node's document."""

    def read(http: httpx.Client, predicate: NamedNode, at: str = "", node: str = "/nodes/camera") -> list[str]:
        subject = NamedNode(str(http.base_url.join(node)) + at)
        found = triples_of(http.get(node, headers=TRIPLES))
        return sorted(each.object.value for each in found if each.subject == subject and each.predicate == predicate)

    return read


def post(http: httpx.Client, transition: object, **headers: str) -> httpx.Response:
    """Request a transition in JSON."""
    return http.post("/nodes/camera", json={"transition": transition}, headers={**PROBLEM, **headers})


def test_a_managed_node_tells_its_state_and_what_is_legal_in_it(http: httpx.Client, said: Any) -> None:
    assert ros.ManagedNode.value in said(http, rdf.type)
    assert said(http, ros.lifecycleState) == [ros.Unconfigured.value]
    assert said(http, ros.lifecycleStateWord) == ["unconfigured"]
    url = f"{http.base_url}nodes/camera"
    assert said(http, td.hasActionAffordance) == [f"{url}#transitions/configure", f"{url}#transitions/shutdown"]
    at = "#transitions/configure"
    assert said(http, ros.targetState, at) == [ros.Configuring.value]
    assert said(http, htv.methodName, f"{at}/invoke") == ["POST"]
    assert said(http, hctl.hasTarget, f"{at}/invoke") == [url]
    assert said(http, ros.shape, at) == [f"{url}{at}/shape"]
    assert said(http, sh.path, f"{at}/shape/transition") == [ros.transition.value]
    assert said(http, sh.hasValue, f"{at}/shape/transition") == ["configure"]
    assert "POST" in http.options("/nodes/camera").headers["allow"]
    assert "application/json" in http.options("/nodes/camera").headers["accept-post"]


def test_a_node_tells_its_endpoints_with_their_quality_of_service_and_its_parameters(
    http: httpx.Client, said: Any, triples_of: Any
) -> None:
    (endpoint,) = said(http, ros.hasEndpoint)
    assert endpoint == f"{http.base_url}topics/chatter#publisher/camera"
    assert said(http, ros.hasParameter) == [f"{http.base_url}parameters/camera/exposure"]
    assert said(http, ros.provides) == [f"{http.base_url}services/camera/change_state"]
    document = triples_of(http.get("/nodes/camera", headers=TRIPLES))
    of_topic = triples_of(http.get("/topics/chatter", headers=TRIPLES))
    own = {
        each
        for each in document
        if each.subject.value in (endpoint, f"{http.base_url}topics/chatter#qos/publisher/camera")
    }
    assert {each.predicate for each in own} >= {ros.ofTopic, ros.ofNode, ros.hasQos, ros.reliability, ros.depth}
    assert own <= of_topic
    (other,) = said(http, ros.hasEndpoint, node="/nodes/plain")
    assert other == f"{http.base_url}topics/chatter#subscriber/plain"


def test_a_transition_is_made_streamed_and_in_the_dataset(http: httpx.Client, said: Any) -> None:
    before = http.get("/nodes/camera").headers["etag"]
    query = "SELECT ?state WHERE { ?node a ros:ManagedNode ; ros:lifecycleState ?state }"
    with http.stream("GET", "/nodes/camera?format=nt", headers={"Accept": "text/event-stream"}) as stream:
        lines = stream.iter_lines()
        assert next(line for line in lines if "lifecycleState>" in line).count(ros.Unconfigured.value)
        made = post(http, "configure")
        assert (made.status_code, made.content) == (204, b"")
        assert next(line for line in lines if ros.Inactive.value in line)
    assert said(http, ros.lifecycleState) == [ros.Inactive.value]
    rows = http.get("/sparql", params={"query": query}, headers={"Accept": "text/csv"}).text.split()
    assert rows == ["state", ros.Inactive.value]
    assert http.get("/nodes/camera").headers["etag"] != before
    url = str(http.base_url.join("/nodes/camera"))
    body = f"<{url}> <{ros.transition.value}> 'activate' ."
    headers = {"Content-Type": "text/turtle", "Prefer": "return=representation", **TRIPLES}
    shown = http.post("/nodes/camera", content=body, headers=headers)
    assert shown.status_code == 200
    assert ros.Active.value in shown.text


def test_a_transition_that_is_not_legal_or_not_made_is_told_with_the_state(http: httpx.Client, camera: Managed) -> None:
    refused = post(http, "activate")
    assert refused.status_code == 409
    told = refused.json()
    assert (told["state"], told["transitions"], told["sent"]) == ("unconfigured", ["configure", "shutdown"], "no")
    assert told["detail"] == "'activate' is not a valid transition of /camera now"
    assert not camera.asked
    camera.fails["configure"] = False
    failed = post(http, "configure").json()
    assert (failed["status"], failed["state"], failed["sent"]) == (409, "unconfigured", "yes")
    assert camera.asked == ["configure"]
    for error, status, sent in (
        (TimedOut("/camera/change_state did not answer in time", sent=Sent.MAYBE), 504, "maybe"),
        (Unreachable("its node went away", sent=Sent.MAYBE), 503, "maybe"),
        (Unreachable("no server was connected"), 503, "no"),
    ):
        camera.fails["configure"] = error
        answer = post(http, "configure")
        assert (answer.status_code, answer.json()["sent"]) == (status, sent)


def test_what_names_no_transition_is_refused(http: httpx.Client, camera: Managed) -> None:
    bodies = ("[]", '"activate"', "{}", '{"transition": 3}', '{"transition": "configure", "x": 1}')
    for body in (*bodies, '{"transition": null}'):
        answer = http.post("/nodes/camera", content=body, headers={**PROBLEM, "Content-Type": "application/json"})
        assert answer.status_code == 422, answer.text
    headers = {**PROBLEM, "Content-Type": "text/turtle"}
    two = f"<> <{ros.transition.value}> 'configure', 'shutdown' ."
    assert http.post("/nodes/camera", content=two, headers=headers).status_code == 422
    assert http.post("/nodes/camera", content="no turtle", headers=headers).status_code == 400
    assert http.post("/nodes/camera", content="x", headers={"Content-Type": "text/plain"}).status_code == 415
    assert not camera.asked


def test_a_precondition_and_the_stop_guard_a_transition(http: httpx.Client, camera: Managed) -> None:
    etag = http.get("/nodes/camera").headers["etag"]
    camera.stands("inactive")
    assert post(http, "activate", **{"If-Match": etag}).status_code == 412
    assert not camera.asked
    assert post(http, "activate", **{"If-Match": http.get("/nodes/camera").headers["etag"]}).status_code == 204
    assert http.post("/stop", json={}).status_code < 300
    asked = list(camera.asked)
    assert post(http, "deactivate").status_code == 423
    assert camera.asked == asked


def test_nodes_without_a_lifecycle_or_whose_state_is_not_known_take_no_post(
    http: httpx.Client, camera: Managed, said: Any
) -> None:
    plain = http.post("/nodes/plain", json={"transition": "activate"}, headers=PROBLEM)
    assert plain.status_code == 405
    assert "no lifecycle" in plain.json()["detail"]
    assert http.post("/nodes/none", json={"transition": "activate"}).status_code in (404, 405)
    camera.stands(Lifecycle("/camera/change_state", unknown="the package lifecycle_msgs is not installed"))
    unknown = post(http, "configure")
    assert unknown.status_code == 405
    assert "not installed" in unknown.json()["detail"]
    assert said(http, ros.lifecycleUnknown) == ["the package lifecycle_msgs is not installed"]
    assert said(http, ros.lifecycleState) == []
    assert "not installed" in http.get("/nodes/camera", headers={"Accept": "text/html"}).text
    camera.stands(replace(standing("/camera", "active"), transitions=(), unknown="it did not answer"))
    assert said(http, ros.lifecycleState) == [ros.Active.value], "the last that was known"
    assert said(http, ros.lifecycleUnknown) == ["it did not answer"]
    assert said(http, td.hasActionAffordance) == []
    camera.stands("finalized")
    refused = post(http, "activate").json()
    assert (refused["status"], refused["state"], refused["transitions"]) == (409, "finalized", [])


def test_what_is_closed_offers_no_transitions(camera: Managed, triples_of: Any) -> None:
    closed: tuple[tuple[dict[str, Any], str], ...] = (
        ({"read_only": True}, "read-only"),
        ({"resources_only": ("/camera",)}, "/camera can be written only through /resources/"),
        ({"resources_only": ("/camera/*",)}, "/camera/change_state can be written only through /resources/"),
    )
    for settings, says in closed:
        with served(camera, **settings) as http:
            refused = post(http, "configure")
            assert refused.status_code == 405
            assert says in refused.json()["detail"]
            found = triples_of(http.get("/nodes/camera", headers=TRIPLES))
            assert td.hasActionAffordance not in {each.predicate for each in found}
    assert not camera.asked


def test_limits_hold_for_transitions(camera: Managed, tmp_path: Path) -> None:
    type = "https://w3id.org/rosld/types/lifecycle_msgs/msg/Transition"
    path = tmp_path / "limits.ttl"
    for target, of in (
        ("sh:targetNode <nodes/camera>", ros.transition.value),
        (f"sh:targetClass <{type}>", f"{type}#label"),
    ):
        shape = f"<#limit> a sh:NodeShape ; {target} ; sh:property [ sh:path <{of}> ; sh:in ( 'configure' ) ] ."
        path.write_text(f"@prefix sh: <http://www.w3.org/ns/shacl#> . {shape}")
        camera.stands("unconfigured")
        with served(camera, shapes=(path,)) as http:
            refused = post(http, "shutdown")
            assert refused.status_code == 422, refused.text
            assert "shutdown" not in camera.asked
            assert post(http, "configure").status_code == 204


def test_the_page_has_a_button_for_each_transition(http: httpx.Client, camera: Managed) -> None:
    def buttons(page: str) -> list[str]:
        return re.findall(r'<button type="submit" name="transition" value="(\w+)"', page)

    page = http.get("/nodes/camera", headers={"Accept": "text/html"}).text
    assert buttons(page) == ["configure", "shutdown"]
    own = page[page.index('class="form choice"') :]
    (name, token) = re.findall(r'name="(_?csrf)" value="([^"]+)"', own)[0]
    form = {name: token, "method": "POST"}
    done = http.post("/nodes/camera", data={**form, "transition": "configure"}, headers={"Accept": "text/html"})
    assert done.status_code == 303, done.text
    camera.fails["activate"] = False
    failed = http.post("/nodes/camera", data={**form, "transition": "activate"}, headers={"Accept": "text/html"})
    assert failed.status_code == 409
    assert "did not make the transition" in failed.text
    assert buttons(failed.text) == ["cleanup", "activate", "shutdown"]
    assert http.post("/nodes/camera", data={**form, "x": "y"}, headers={"Accept": "text/html"}).status_code == 422


def test_the_description_tells_of_transitions_where_there_are_any(http: httpx.Client) -> None:
    paths = http.get("/openapi.json").json()["paths"]
    managed, plain = (paths[f"/nodes/{name}"] for name in ("camera", "plain"))
    assert "post" in managed
    assert "post" not in plain
