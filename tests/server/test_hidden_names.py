"""Hidden names of ROS 2: omitted from listings by default, but available at their own URLs."""

from __future__ import annotations

import httpx
import pytest
from msgspec.structs import replace
from pyoxigraph import NamedNode, RdfFormat, parse

from rosld.ontology.vocab import ldp, rdfs
from tests.crawl.description import inlined
from tests.server.robots.made_up import MadeUp, Serving

READ, JSON = {"accept": "application/n-triples"}, {"accept": "application/json"}


@pytest.fixture
def hiding(robot: MadeUp) -> MadeUp:
    """A robot with hidden names."""
    robot.capabilities = replace(robot.capabilities, hidden_names=True)
    robot.topic("/chatter", "std_msgs/msg/String")
    robot.topic("/fly/height", "std_msgs/msg/String")
    robot.topic("/fly/_action/feedback", "std_msgs/msg/String", {"data": "climbing"})
    robot.topic("/deep/_x/y", "std_msgs/msg/String")
    robot.answer("/_daemon/ping", "made_up/srv/GetByte", value=1)
    return robot


@pytest.fixture
def client(hiding: MadeUp, serving: Serving) -> httpx.Client:
    return serving()


def told(text: str, url: str, predicate: NamedNode) -> set[str]:
    triples = [quad.triple for quad in parse(text.encode(), format=RdfFormat.N_TRIPLES)]
    found = {one.object.value for one in triples if one.subject == NamedNode(url) and one.predicate == predicate}
    return {each.removeprefix(url) for each in found}


def listing(client: httpx.Client, path: str, predicate: NamedNode = ldp.contains) -> set[str]:
    answer = client.get(path, headers=READ)
    assert answer.status_code == 200, answer.text
    return told(answer.text, str(answer.url).partition("?")[0], predicate)


@pytest.mark.slow
def test_listings_leave_hidden_names_out_unless_they_are_asked_for(client: httpx.Client) -> None:
    assert listing(client, "/topics/") == {"chatter", "fly/"}
    assert listing(client, "/topics/?hidden=true") == {"chatter", "fly/", "deep/"}
    assert listing(client, "/topics/deep/") == set()
    assert listing(client, "/topics/fly/") == listing(client, "/topics/fly/?hidden=false") == {"height"}
    assert listing(client, "/topics/fly/?hidden=true") == {"height", "_action/"}
    assert listing(client, "/services/") == set()
    assert listing(client, "/services/?hidden=true") == {"_daemon/"}
    assert listing(client, "/topics/fly/", rdfs.seeAlso) == {"?hidden=true"}
    assert listing(client, "/topics/fly/?hidden=true", rdfs.seeAlso) == set()
    assert listing(client, "/nodes/", rdfs.seeAlso) == set()
    one, other = client.get("/topics/fly/", headers=READ), client.get("/topics/fly/?hidden=true", headers=READ)
    assert one.headers["etag"] != other.headers["etag"]
    kept = client.get("/topics/fly/?hidden=true", headers={**READ, "if-none-match": one.headers["etag"]})
    assert kept.status_code == 200
    assert client.get("/topics/?hidden=perhaps", headers=READ).status_code == 400
    assert "_action/feedback" not in client.get("/topics/", headers={"accept": "text/html"}).text
    assert "_action/feedback" in client.get("/topics/?hidden=true", headers={"accept": "text/html"}).text
    ask = f"ASK {{ GRAPH <topics/fly/> {{ ?c <{ldp.contains.value}> <topics/fly/%s> }} }}"
    for name, there in (("height", True), ("_action/", False)):
        answer = client.get("/sparql", params={"query": ask % name}, headers=JSON)
        assert answer.json()["boolean"] is there


def test_hidden_things_answer_under_their_own_urls(client: httpx.Client) -> None:
    assert client.get("/topics/fly/_action/feedback", headers=JSON).json() == {"data": "climbing"}
    assert listing(client, "/topics/fly/_action/") == {"feedback"}


def test_pages_of_a_listing_keep_to_what_was_asked_for(client: httpx.Client, robot: MadeUp) -> None:
    robot.owners = ("/robot", "/_daemon")
    for name in ("/robot/gain", "/_daemon/a"):
        robot.parameter(name, 1)
    for path, members in (
        ("topics/?hidden=true", {"chatter", "deep/", "fly/"}),
        ("parameters/", {"robot/"}),
        ("parameters/?hidden=true", {"robot/", "_daemon/"}),
    ):
        asked = {**READ, "prefer": "return=representation; max-member-count=1"}
        answer, found = client.get(f"/{path}", headers=asked), set[str]()
        link: str | None = answer.headers.get("location", str(answer.url))
        while link is not None:
            answer = client.get(link, headers=READ)
            found |= told(answer.text, f"{client.base_url}{path.partition('?')[0]}", ldp.contains)
            link = answer.links.get("next", {}).get("url")
        assert found == members


def test_the_description_leaves_them_out_and_tells_how_to_ask_for_them(client: httpx.Client, robot: MadeUp) -> None:
    robot.parameter("/listener/gain", 1)
    description = client.get("/openapi.json").json()
    paths = description["paths"]
    assert "/topics/chatter" in paths
    assert not [path for path in paths if "/_" in path]
    assert "/topics/fly/_action/feedback" in client.get("/openapi.json?hidden=true").json()["paths"]

    def queries(path: str) -> set[str]:
        return {each["name"] for each in inlined(description)[path]["get"]["parameters"]}

    for path in ("/topics/", "/services/", "/nodes/", "/actions/", "/parameters/", "/openapi.json"):
        assert "hidden" in queries(path), path
    assert "hidden" not in queries("/topics/chatter")


def test_parameters_of_hidden_nodes_are_hidden_as_they_are(hiding: MadeUp, serving: Serving) -> None:
    hiding.capabilities = replace(hiding.capabilities, parameter_trees=False)
    hiding.owners = ("/robot", "/deep/_tool", "/_daemon")
    for name in ("/robot/gain", "/robot/_odd", "/deep/_tool/x", "/_daemon/a/b"):
        hiding.parameter(name, 1)
    client = serving()
    assert listing(client, "/parameters/") == {"robot/"}
    assert listing(client, "/parameters/", rdfs.seeAlso) == {"?hidden=true"}
    assert listing(client, "/parameters/robot/") == {"gain", "_odd"}
    assert listing(client, "/parameters/robot/", rdfs.seeAlso) == set()
    assert listing(client, "/parameters/?hidden=true") == {"robot/", "deep/", "_daemon/"}
    assert client.get("/parameters/", headers=JSON).json() == {"robot": {"gain": 1, "_odd": 1}}
    assert client.get("/parameters/?hidden=true", headers=JSON).json()["_daemon"] == {"a": {"b": 1}}
    assert client.get("/parameters/_daemon/", headers=JSON).json() == {"a": {"b": 1}}
    assert client.get("/parameters/deep/_tool/x", headers=JSON).json() == 1
    assert "/parameters/_daemon/a/b" not in client.get("/openapi.json").json()["paths"]


def test_a_robot_of_a_kind_without_hidden_names_lists_all(robot: MadeUp, serving: Serving) -> None:
    robot.topic("/fly/_action/feedback", "std_msgs/msg/String")
    client = serving()
    assert listing(client, "/topics/fly/") == {"_action/"}
    assert listing(client, "/topics/fly/", rdfs.seeAlso) == set()
    assert "/topics/fly/_action/feedback" in client.get("/openapi.json").json()["paths"]
