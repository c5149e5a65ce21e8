"""Resources of an unknown type: listed with the name of the type, and refused with a reason on use."""

from __future__ import annotations

import httpx
import pytest

from rosld.adapters.model import Action, Endpoint, Service, Topic, TypeRef
from tests.server.robots.made_up import MadeUp, Serving

JSON = {"accept": "application/json", "content-type": "application/json"}


@pytest.fixture
def client(robot: MadeUp, serving: Serving) -> httpx.Client:
    robot.strange(
        Topic("/odd/topic", (TypeRef("odd/msg/Thing"),), subscribers=(Endpoint("/listener"),)),
        Service("/odd/service", TypeRef("odd/srv/Ask"), ("/robot",)),
        Service("/odd/both", None, ("/robot",), "it has several types: odd/srv/Ask, odd/srv/Tell"),
        Action("/odd/action", TypeRef("odd/action/Walk"), ("/robot",)),
        Action("/odd/untyped", None, ("/robot",), unusable="it has the types odd/action/Walk, odd/action/Run"),
    )
    return serving()


def test_a_thing_of_an_unknown_type_is_described_and_not_used(client: httpx.Client) -> None:
    for method, path, words in (
        ("PUT", "/topics/odd/topic", "odd/msg/Thing"),
        ("POST", "/services/odd/service", "odd/srv/Ask"),
        ("POST", "/services/odd/both", "it has several types: odd/srv/Ask, odd/srv/Tell"),
        ("POST", "/actions/odd/action", "odd/action/Walk"),
        ("POST", "/actions/odd/untyped", "it has the types odd/action/Walk, odd/action/Run"),
    ):
        refused = client.request(method, path, json={}, headers=JSON)
        assert (refused.status_code, words in refused.json()["detail"]) == (409, True), refused.text
    for path in ("/topics/odd/topic", "/services/odd/service", "/actions/odd/action"):
        answer = client.get(path, headers={"accept": "text/turtle"})
        assert (answer.status_code, "/types/odd/" in answer.text) == (200, True)
        assert client.get(path, headers={"accept": "text/html"}).status_code == 200
    for path in ("/types/odd/msg/Thing", "/types/odd/srv/Ask", "/shapes/odd/action/Walk_Goal"):
        answer = client.get(path, headers=JSON)
        assert (answer.status_code, "--types DIR" in answer.json()["detail"]) == (404, True), answer.text
    assert client.get("/openapi.json").status_code == 200
