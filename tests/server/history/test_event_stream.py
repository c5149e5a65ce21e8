"""Recordings as event streams: pages that never change, the newest that does, profiles, and permissions."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from pyoxigraph import NamedNode, RdfFormat, parse

from rosld.server.http.negotiation import choose_profile, parse_prefer
from rosld.server.resources.event_stream import MEMBERS, PageNumber, pages_between, top_level
from tests.adapters.recording.recorder import lines, write_rosbag1
from tests.server.auth.conftest import rule, token, tokens
from tests.waiting import until

pytestmark = pytest.mark.slow

NQUADS = {"Accept": "application/n-quads"}
NTRIPLES = {"Accept": "application/n-triples"}
JSON = {"Accept": "application/json"}
TREE, LDES, SOSA = "https://w3id.org/tree#", "https://w3id.org/ldes#", "http://www.w3.org/ns/sosa/"
COUNT = 230


@pytest.fixture(scope="module")
def sent(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """Return a recording of 230 lines."""
    return write_rosbag1(tmp_path_factory.mktemp("sent") / "talk.bag", lines(count=COUNT)).read_bytes()


@pytest.fixture(scope="module")
def recorded(start_server: Callable[..., Any], sent: bytes) -> Any:
    """A rover with a history and an uploaded recording."""
    server = start_server("rover", "--history", "/imu")
    assert server.http.put("/bags/talk", content=sent).status_code == 201
    return server


def objects(text: str, predicate: str) -> list[str]:
    """Return the values of a predicate, in order."""
    quads = parse(text.encode(), format=RdfFormat.N_QUADS)
    return [quad.object.value for quad in quads if quad.predicate == NamedNode(predicate)]  # type: ignore[union-attr]


def pages(http: Any, url: str, headers: dict[str, str]) -> Iterator[Any]:
    """Yield every page of a stream, starting with the first."""
    answer = http.get(url, headers=NQUADS | headers)
    assert answer.status_code == 200, answer.text
    yield answer
    for found in dict.fromkeys(objects(answer.text, TREE + "node")):
        yield from pages(http, found, headers)


def members(http: Any, url: str, headers: dict[str, str] | None = None) -> list[str]:
    return [each for page in pages(http, url, headers or {}) for each in objects(page.text, TREE + "member")]


def test_every_message_is_behind_exactly_one_link_of_each_page() -> None:
    for first, beyond in ((0, 1), (0, 100), (0, 10_001), (777, 1_234_567), (5_000_000, 5_000_100)):
        level = top_level(first, beyond)
        ways = list(pages_between(level, first, beyond))
        assert len(ways) <= MEMBERS
        while level:
            level -= 1
            ways = [below for page in ways for below in page.within(first, beyond)]
        assert ways == [PageNumber(0, number) for number in range(first // MEMBERS, (beyond - 1) // MEMBERS + 1)]


def test_pages_of_a_finished_recording_are_immutable_and_have_each_message_as_its_url_says_it(
    recorded: Any,
) -> None:
    http = recorded.http
    first, *others = pages(http, "/bags/talk/ldes", {})
    assert "immutable" not in first.headers["cache-control"]
    assert len(others) == 3
    for page in others:
        assert page.headers["cache-control"] == "max-age=31536000, immutable"
    found = members(http, "/bags/talk/ldes")
    assert found == [f"{recorded.url}bags/talk/messages/{number}" for number in range(COUNT)]
    quads = [quad for page in others for quad in parse(page.content, format=RdfFormat.N_QUADS)]
    for url in found[::60]:
        own = {quad.triple for quad in quads if quad.graph_name == NamedNode(url)}
        alone = parse(http.get(url, headers=NTRIPLES).content, format=RdfFormat.N_TRIPLES)
        assert own == {quad.triple for quad in alone}
    assert objects(first.text, LDES + "timestampPath") == ["https://w3id.org/rosld#recordedAt"]
    assert objects(first.text, LDES + "versionOfPath") == ["https://w3id.org/rosld#onTopic"]
    again = http.get(str(others[0].url), headers=NQUADS | {"If-None-Match": others[0].headers["etag"]})
    assert again.status_code == 304
    assert "/ldes" in http.get("/bags/talk/", headers=NTRIPLES).text


def test_pages_are_the_same_in_every_syntax_and_members_of_one_graph_where_there_are_no_graphs(recorded: Any) -> None:
    page = objects(recorded.http.get("/bags/talk/ldes", headers=NQUADS).text, TREE + "node")[0]
    quads = parse(recorded.http.get(page, headers=NQUADS).content, format=RdfFormat.N_QUADS)
    triples = {str(quad.triple) for quad in quads}
    trig = parse(recorded.http.get(page, headers={"Accept": "application/trig"}).content, format=RdfFormat.TRIG)
    assert {str(quad.triple) for quad in trig} == triples
    for syntax in (RdfFormat.TURTLE, RdfFormat.N_TRIPLES, RdfFormat.RDF_XML, RdfFormat.JSON_LD):
        answer = recorded.http.get(page, headers={"Accept": syntax.media_type})
        assert {str(quad.triple) for quad in parse(answer.content, format=syntax)} == triples
    assert recorded.http.get(page, headers={"Accept": "text/html"}).status_code == 200


def test_relations_bound_the_times_of_all_members_behind_them(recorded: Any) -> None:
    second_page = f"/bags/history/messages/{MEMBERS + 20}"
    until(lambda: recorded.http.head(second_page).status_code == 200, "a past of two pages")
    root = recorded.http.get("/bags/history/ldes", headers=NQUADS)
    quads = list(parse(root.content, format=RdfFormat.N_QUADS))

    def of(relation: Any, name: str) -> str:
        return next(
            each.object.value for each in quads if (each.subject, each.predicate) == (relation, NamedNode(name))
        )

    relations = [quad.object for quad in quads if quad.predicate == NamedNode(TREE + "relation")]
    valued = {quad.subject for quad in quads if quad.predicate == NamedNode(TREE + "value")}
    bounded = [one for one in relations if one in valued]
    assert len(bounded) >= 2
    for relation in bounded:
        page = recorded.http.get(of(relation, TREE + "node"), headers=NQUADS)
        times = objects(page.text, "https://w3id.org/rosld#recordedAt")
        bound = of(relation, TREE + "value").rstrip("Z").ljust(29, "0")
        kind = of(relation, "http://www.w3.org/1999/02/22-rdf-syntax-ns#type")
        for each in times:
            padded = each.rstrip("Z").ljust(29, "0")
            assert padded >= bound if kind == TREE + "GreaterThanOrEqualToRelation" else padded <= bound


def test_a_page_of_the_history_becomes_immutable_once_all_its_messages_are_written_and_never_changes_then(
    recorded: Any,
) -> None:
    http = recorded.http

    def newest() -> Any:
        *_, last = pages(http, "/bags/history/ldes", {})
        return last

    page = newest()
    assert page.headers["cache-control"].startswith("max-age=2")
    assert "immutable" not in page.headers["cache-control"]
    url = str(page.url)
    until(lambda: "immutable" in http.get(url, headers=NQUADS).headers["cache-control"], "the page to be full")
    settled = http.get(url, headers=NQUADS)
    assert set(objects(page.text, TREE + "member")) <= set(objects(settled.text, TREE + "member"))
    assert len(objects(settled.text, TREE + "member")) == MEMBERS
    beyond = max(int(each.rpartition("/")[2]) for each in objects(settled.text, TREE + "member")) + 1
    until(lambda: http.head(f"/bags/history/messages/{beyond}").status_code == 200, "a message of another page")
    assert str(newest().url) != url
    assert http.get(url, headers=NQUADS).text == settled.text


@pytest.mark.parametrize(
    "headers",
    [{"Accept-Profile": f"<urn:x>, <{SOSA}>;q=0.5"}, {"Prefer": "profile=sosa"}, {}],
)
def test_members_are_observations_on_request(recorded: Any, headers: dict[str, str]) -> None:
    root = "/bags/talk/ldes" if headers else "/bags/talk/ldes?_profile=sosa"
    first, page, *_ = pages(recorded.http, root, headers)
    assert first.headers["content-profile"] == f"<{SOSA}>"
    assert {"accept-profile", "prefer"} <= {each.strip().lower() for each in first.headers["vary"].split(",")}
    assert objects(first.text, LDES + "timestampPath") == [SOSA + "resultTime"]
    assert objects(page.text, SOSA + "hasSimpleResult") == [str(number) for number in range(MEMBERS)]
    assert set(objects(page.text, SOSA + "observedProperty")) == {f"{recorded.url}topics/chatter"}
    assert members(recorded.http, root, headers) == members(recorded.http, "/bags/talk/ldes")


def test_a_profile_that_is_not_known_is_passed_over_in_headers_and_refused_in_the_query(recorded: Any) -> None:
    answer = recorded.http.get("/bags/talk/ldes", headers=NQUADS | {"Accept-Profile": "<urn:x>"})
    assert answer.headers["content-profile"] == "<https://w3id.org/rosld#>"
    refused = recorded.http.get("/bags/talk/ldes?_profile=x", headers=JSON)
    assert refused.status_code == 406
    assert "sosa" in refused.json()["detail"]


def test_the_profile_wanted_most_is_chosen() -> None:
    offers = {"a": "urn:a", "b": "urn:b"}
    assert choose_profile(offers, "<urn:a>;q=0.1, <urn:b>", parse_prefer(None), None) == "urn:b"
    assert choose_profile(offers, "<urn:a>;q=0", parse_prefer(None), None) is None
    assert choose_profile(offers, "<urn:a>", parse_prefer('profile="urn:b"'), "b") == "urn:b"
    assert choose_profile(offers, "urn:a, <, ;, <urn:b>;q=x", parse_prefer("profile"), None) is None


def test_a_page_that_is_not_there_says_why(recorded: Any, sent: bytes) -> None:
    page = objects(recorded.http.get("/bags/talk/ldes", headers=NQUADS).text, TREE + "node")[0]
    base, _, _ = page.rpartition("-0-")
    for name, status in (("-0-3", 404), ("-9-0", 404), ("-0-x", 404), ("-0", 404), ("-999999999999999-9", 404)):
        assert recorded.http.get(base + name, headers=JSON).status_code == status, name
    assert recorded.http.get(f"{recorded.url}bags/talk/ldes/00000000-0-0", headers=JSON).status_code == 410
    assert recorded.http.get("/bags/none/ldes", headers=JSON).status_code == 404


def test_who_may_not_read_a_message_is_not_told_of_it_as_a_member(
    serve: Callable[..., Any], tmp_path: Path, sent: bytes
) -> None:
    auth = tmp_path / "auth.toml"
    views = "/bags/talk/ldes /bags/talk/ldes/** /bags/talk/messages/ /bags/talk/messages/7 /topics/**"
    rules = rule("anna", "read write", "/bags/**", "/topics/**") + rule("bert", "read", views)
    auth.write_text(rules + tokens("anna", "bert"))
    http = serve("aircraft", "--auth", str(auth)).http
    anna, bert = ({"Authorization": f"Bearer {token(name)}"} for name in ("anna", "bert"))
    assert http.put("/bags/talk", content=sent, headers=anna).status_code == 201
    assert http.get("/bags/talk/ldes", headers=NQUADS).status_code == 401
    assert len(members(http, "/bags/talk/ldes", anna)) == COUNT
    only = members(http, "/bags/talk/ldes", bert)
    assert [each.rpartition("/")[2] for each in only] == ["7"]
    text = "".join(page.text for page in pages(http, "/bags/talk/ldes", bert))
    assert "/messages/8" not in text
    listed = http.get("/bags/talk/messages/?limit=20", headers=JSON | bert).json()["messages"]
    assert [each["index"] for each in listed] == [7]
    assert "/messages/8" not in http.get("/bags/talk/messages/?limit=20", headers=NTRIPLES | bert).text
