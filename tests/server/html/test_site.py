"""Names and links of URLs on pages, and symbols of units."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from rosld.ontology.urls import Space
from rosld.server.html.frame import breadcrumb
from rosld.server.html.site import Site

SITE = Site("http://127.0.0.1:8080/", "robot")
BELOW = Site("https://example.org/robots/one/", "one")
NAMES = st.lists(st.text(st.characters(exclude_categories=["Cs"])), min_size=1, max_size=4).map(
    lambda parts: "/" + "/".join(parts)
)


ANCHORS = {
    "http://127.0.0.1:8080/topics/a/b": ("/topics/a/b", "/a/b"),
    "http://127.0.0.1:8080/topics/a/": ("/topics/a/", "/a/"),
    "http://127.0.0.1:8080/": ("/", "robot"),
    "http://127.0.0.1:8080/topics/": ("/topics/", "topics/"),
    "http://127.0.0.1:8080/topics/a%20b": ("/topics/a%20b", "/a b"),
    "http://127.0.0.1:8080/calls/7f": ("/calls/7f", "7f"),
    "https://w3id.org/rosld/types/std_msgs/msg/String": ("/types/std_msgs/msg/String", "std_msgs/msg/String"),
    "https://w3id.org/rosld#Topic": ("/ontology#Topic", "ros:Topic"),
    "http://www.w3.org/ns/ldp#Resource": ("http://www.w3.org/ns/ldp#Resource", "ldp:Resource"),
    "https://elsewhere.example/x": ("https://elsewhere.example/x", "https://elsewhere.example/x"),
}
NO_LINKS = (
    "javascript:alert(1)", "JaVaScRiPt:alert(1)", "data:text/html,x", "vbscript:x", "file:///etc/passwd", "//x/y",
    "mailto:a@example.org", "http://a\nb", "http://a b", "\x01http://a", "http:\\\\a", "urn:x", "", "/topics/a",
    "http://a/\u202ex",
)  # fmt: skip


def test_iris_are_linked_and_called_by_what_they_name() -> None:
    anchors = {iri: SITE.anchor(iri) for iri in ANCHORS}
    assert {iri: (each.href, each.text) for iri, each in anchors.items() if each} == ANCHORS
    assert BELOW.href("https://example.org/robots/one/topics/a") == "/robots/one/topics/a"
    assert BELOW.href("https://w3id.org/rosld#Topic") == "/robots/one/ontology#Topic"


def test_only_plain_web_addresses_are_links_and_a_local_path_never_reads_as_another_host() -> None:
    assert not [iri for iri in NO_LINKS if SITE.href(iri) is not None]
    assert SITE.href("http://127.0.0.1:8080//evil.example/x") == "http://127.0.0.1:8080//evil.example/x"


@given(NAMES)
def test_every_ros_name_is_called_by_its_name(name: str) -> None:
    assert SITE.short_name(Space(SITE.base).topic(name)) == name


@given(NAMES)
def test_a_breadcrumb_leads_from_the_entry_to_the_page(name: str) -> None:
    url = Space(SITE.base).topic(name)
    crumbs = breadcrumb(SITE, url)
    assert [crumbs[0].url, crumbs[1].url, crumbs[-1].url] == [SITE.base, f"{SITE.base}topics/", url]
    assert len(crumbs) == 2 + name.count("/")
    assert all(url.startswith(crumb.url) for crumb in crumbs)
