"""Names to URLs and back."""

from __future__ import annotations

import shutil
import subprocess
from urllib.parse import urljoin, urlsplit

import httpx
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from pyoxigraph import NamedNode, RdfFormat, parse

from rosld.adapters.model import TypeRef
from rosld.ontology.urls import Location, Space, encode_segment, locate

SPACE = Space("http://127.0.0.1:8080/")

HOSTILE = [
    "", ".", "..", "~", "~.", "~..", "~~", "...", "%2F", "%2e", "?", "#", " ", "a b", "ü", "💡", "a:b", "\x00", "*",
]  # fmt: skip
segments = st.sampled_from(HOSTILE) | st.text(st.characters(exclude_categories=["Cs"], exclude_characters="/"))
names = st.lists(segments, min_size=1).map(lambda parts: "/" + "/".join(parts))


def raw_path(url: str) -> str:
    return url.removeprefix(SPACE.base[:-1])


@given(names)
@example("/a//b")
@example("//")
@example("/")
@example("/a/../b")
def test_a_name_comes_back_from_its_url(name: str) -> None:
    location = locate(raw_path(SPACE.topic(name)))
    assert location.kind == "topics"
    assert location.name == name
    assert not location.is_container


@given(st.lists(segments).map(tuple))
def test_a_namespace_comes_back_from_its_url(namespace: tuple[str, ...]) -> None:
    assert locate(raw_path(SPACE.container("topics", namespace))) == Location("topics", namespace, True)


@given(names, names, st.lists(segments).map(tuple))
def test_no_two_names_and_no_name_and_namespace_share_a_url(one: str, other: str, namespace: tuple[str, ...]) -> None:
    assert (SPACE.topic(one) == SPACE.topic(other)) == (one == other)
    assert SPACE.topic(one) != SPACE.container("topics", namespace)


@given(names)
def test_urls_are_absolute_iris_that_clients_leave_alone(name: str) -> None:
    url = SPACE.topic(name)
    assert NamedNode(url).value == url
    assert urljoin("http://elsewhere/", url) == url
    assert httpx.URL(url).raw_path.decode() == urlsplit(url).path
    (triple,) = parse(f"@base <http://elsewhere/> . <{url}> a <{url}> .", format=RdfFormat.TURTLE)
    assert triple.subject == NamedNode(url)


@pytest.mark.skipif(shutil.which("curl") is None, reason="curl is not installed")
@pytest.mark.slow
def test_curl_sends_the_path_as_it_is() -> None:
    names = ["/./a", "/../a", "//a", "/a/", "/a//", "/~/./~.", "/a b/%2F"]
    urls = [SPACE.topic(name).replace(":8080", ":1") for name in names]
    command = ["curl", "-s", "-w", "%{url_effective}\n", "--max-time", "2", *urls]
    run = subprocess.run(command, capture_output=True, text=True, check=False)
    assert run.stdout.split() == urls


def test_plain_names_look_like_themselves_and_variants_of_types_have_their_hash() -> None:
    assert SPACE.topic("/camera/image_raw") == "http://127.0.0.1:8080/topics/camera/image_raw"
    assert SPACE.container("topics", ("camera",)) == "http://127.0.0.1:8080/topics/camera/"
    assert SPACE.shape("std_srvs/srv/Trigger_Request") == "http://127.0.0.1:8080/shapes/std_srvs/srv/Trigger_Request"
    assert SPACE.bag_message("run", 7) == "http://127.0.0.1:8080/bags/run/messages/7"
    assert SPACE.type(TypeRef("a/msg/B", "d41d")) == "http://127.0.0.1:8080/types/a/msg/B?hash=d41d"
    assert SPACE.property_of("geometry_msgs/msg/Twist", "linear").endswith("/geometry_msgs/msg/Twist#linear")


def test_special_segments_are_escaped_with_a_tilde() -> None:
    assert [encode_segment(s) for s in ("", ".", "..", "~", "~.", "~a", "...")] == [
        "~", "~.", "~..", "~~", "~~.", "~a", "...",
    ]  # fmt: skip


def test_a_ros_2_parameter_is_one_segment_below_its_node() -> None:
    url = SPACE.parameter("qos_overrides./cmd_vel.publisher.depth", "/talker")
    assert url.endswith("/parameters/talker/qos_overrides.%2Fcmd_vel.publisher.depth")
    assert locate(raw_path(url)).segments == ("talker", "qos_overrides./cmd_vel.publisher.depth")


@pytest.mark.parametrize(
    ("path", "words"),
    [
        *((f"/topics/{each}", "malformed percent-escape '%.*%25") for each in ("a%", "a%2", "a%zz", "%GG")),
        *((f"/topics/{each}", "not percent-encoded UTF-8") for each in ("%FF", "%C3", "%ED%A0%80")),
        *((f"/topics/{each}", "write '~") for each in ("/a", "./a", "%2E%2e/a", "a//")),
        ("/topics/a%2Fb", "contains a slash"),
        (b"/topics/\xff", "not UTF-8"),
    ],
)
def test_a_path_that_is_no_url_of_a_name_is_refused_with_the_reason(path: str | bytes, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        _ = locate(path).name


def test_lone_surrogates_and_relative_names_have_no_url() -> None:
    with pytest.raises(ValueError, match="surrogate"):
        SPACE.topic("/\ud800")
    with pytest.raises(ValueError, match="begin with '/'"):
        SPACE.topic("chatter")


def test_the_entry_point_and_the_top_containers() -> None:
    assert locate("/") == Location("", (), True)
    assert locate("/topics") == Location("topics", (), False)
    assert locate("/topics/") == Location("topics", (), True)
    assert locate("/topics/").name == "/"
    assert locate("/topics/ü".encode()).name == "/ü"
    assert locate("/topics/~").name == "/"
    assert locate("/topics/~") != locate("/topics/")


def test_urls_of_the_space_are_located_whatever_their_query_and_fragment() -> None:
    space = Space("https://robots.example/one/")
    assert space.path == "/one/"
    assert space.location("https://robots.example/one/topics/a?x=/#message") == Location("topics", ("a",), False)
    assert space.location("https://robots.example/two/topics/a") is None
    assert space.location("https://robots.example/one/topics/%zz") is None


@pytest.mark.parametrize("base", ["", "/", "http://h", "h/", "http://h/?x/", "http://h/#/"])
def test_a_base_must_be_an_absolute_url_that_ends_in_a_slash(base: str) -> None:
    with pytest.raises(ValueError, match="must be an absolute URL"):
        Space(base)
