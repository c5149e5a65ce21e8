"""What is of a type that nobody tells: listed with its type's name, and refused in words where it is used."""

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


@pytest.mark.parametrize(
    ("method", "path", "words"),
    [
        ("PUT", "/topics/odd/topic", "odd/msg/Thing"),
        ("POST", "/services/odd/service", "odd/srv/Ask"),
        ("POST", "/services/odd/both", "it has several types: odd/srv/Ask, odd/srv/Tell"),
        ("POST", "/actions/odd/action", "odd/action/Walk"),
        ("POST", "/actions/odd/untyped", "it has the types odd/action/Walk, odd/action/Run"),
    ],
)
def test_it_is_not_used_and_the_answer_names_the_type_and_the_next_step(
    client: httpx.Client, method: str, path: str, words: str
) -> None:
    answer = client.request(method, path, json={}, headers=JSON)
    assert answer.status_code == 409, answer.text
    assert words in answer.json()["detail"]


@pytest.mark.parametrize("path", ["/topics/odd/topic", "/services/odd/service", "/actions/odd/action"])
def test_it_is_described_all_the_same(client: httpx.Client, path: str) -> None:
    answer = client.get(path, headers={"accept": "text/turtle"})
    assert answer.status_code == 200
    assert "/types/odd/" in answer.text
    assert client.get(path, headers={"accept": "text/html"}).status_code == 200
    assert client.get("/openapi.json").status_code == 200


@pytest.mark.parametrize("path", ["/types/odd/msg/Thing", "/types/odd/srv/Ask", "/shapes/odd/action/Walk_Goal"])
def test_its_type_is_not_found_and_the_answer_says_where_to_put_it(client: httpx.Client, path: str) -> None:
    answer = client.get(path, headers=JSON)
    assert answer.status_code == 404, answer.text
    assert "--types DIR" in answer.json()["detail"]
