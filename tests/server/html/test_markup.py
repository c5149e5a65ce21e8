"""Common properties of all pages: valid, accessible HTML without scripts or markup from a robot."""

from __future__ import annotations

import re
from collections.abc import Mapping
from html.parser import HTMLParser
from itertools import pairwise

import html5rdf  # type: ignore[import-untyped]
import pytest

from rosld.server.html.frame import ASSETS
from rosld.server.html.site import CONTENT_SECURITY_POLICY
from tests.crawl.site import HTML, site
from tests.server.html.hostile_pages import HOSTILE

pytestmark = pytest.mark.slow

VOID = frozenset({"meta", "link", "img", "input", "br", "hr", "wbr"})


class Reader(HTMLParser):
    """Strict parser of a page: checks that elements are closed in order, and stores their content."""

    def __init__(self, text: str) -> None:
        super().__init__(convert_charrefs=True)
        self.open: list[str] = []
        self.elements: list[tuple[str, dict[str, str | None], tuple[str, ...]]] = []
        self.text: list[str] = []
        self.feed(text)
        self.close()
        assert not self.open, f"left open: {self.open}"

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        names = [name for name, _ in attrs]
        assert len(names) == len(set(names)), f"<{tag}> has an attribute twice: {names}"
        self.elements.append((tag, dict(attrs), tuple(self.open)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        raise AssertionError(f"<{tag}/> is no HTML")

    def handle_endtag(self, tag: str) -> None:
        assert self.open[-1:] == [tag], f"</{tag}> closes {self.open}"
        self.open.pop()

    def handle_data(self, data: str) -> None:
        self.text.append(data)

    def all(self, tag: str) -> list[dict[str, str | None]]:
        return [attributes for name, attributes, _ in self.elements if name == tag]

    @property
    def ids(self) -> list[str]:
        return [each["id"] or "" for _, each, _ in self.elements if "id" in each]


@pytest.fixture(scope="module")
def read(pages: Mapping[str, bytes]) -> Mapping[str, Reader]:
    """Every page by its name, and the first page of each kind of the aircraft by its URL."""
    texts = {name: body.decode("utf-8") for name, body in pages.items()}
    crawled = site("aircraft").others
    texts |= {url: answers[HTML].text for url, answers in crawled.items() if answers[HTML].media_type == HTML}
    assert len(texts) > 100
    return {name: Reader(text) for name, text in texts.items()}


def test_the_strict_parser_of_html5_finds_no_fault(pages: Mapping[str, bytes]) -> None:
    for name, body in pages.items():
        parser = html5rdf.HTMLParser()
        parser.parse(body.decode())
        assert not parser.errors, name


def test_ids_are_unique_and_hold_no_space(read: Mapping[str, Reader]) -> None:
    for where, page in read.items():
        assert len(page.ids) == len(set(page.ids)), where
        assert not [each for each in page.ids if not each or re.search(r"\s", each)], where


def test_nothing_is_run_and_nothing_is_styled_in_place(read: Mapping[str, Reader]) -> None:
    for where, page in read.items():
        for tag, attributes, _ in page.elements:
            assert tag not in ("style", "iframe", "object", "embed", "base", "math", "use", "image", "foreignObject"), (
                where
            )
            assert not [
                name for name in attributes if name.startswith("on") or name in ("style", "srcdoc", "formaction")
            ], where


def test_scripts_are_our_own_files_and_wait_for_the_page(read: Mapping[str, Reader]) -> None:
    for where, page in read.items():
        scripts = [each for each in page.all("script") if each.get("type") != "application/ld+json"]  # data
        names = [re.sub(r"\?v=[0-9a-f]{8}$", "", each["src"] or "").removeprefix("/") for each in scripts]
        assert set(names) <= ASSETS.keys(), where
        assert len(names) == len(set(names)), where
        assert all(each.get("type") == "module" or "defer" in each for each in scripts), where


def test_only_http_and_local_references_are_links(read: Mapping[str, Reader]) -> None:
    for where, page in read.items():
        for tag, attributes, _ in page.elements:
            for name in ("href", "src", "action"):
                target = attributes.get(name)
                if target is not None:
                    assert re.match(r"(https?://|/(?!/)|[?#])", target), (where, tag, target)


def test_nothing_is_fetched_from_elsewhere(read: Mapping[str, Reader]) -> None:
    for where, page in read.items():
        assert all(
            (each["src"] or "").startswith(("/icon.svg", "?format=jpeg&", "?format=png&")) for each in page.all("img")
        )
        fetched = [each for each in page.all("link") if each["rel"] in ("stylesheet", "icon")]
        assert fetched, where
        assert all((each["href"] or "").startswith("/") for each in fetched), where
        assert b"url(" not in ASSETS["style.css"], where
        assert b"@import" not in ASSETS["style.css"], where


def test_landmarks_and_one_heading_of_the_first_level(read: Mapping[str, Reader]) -> None:
    for where, page in read.items():
        for tag in ("main", "h1", "title"):
            assert len([each for each, _, place in page.elements if each == tag and "svg" not in place]) == 1, tag
        assert len([place for tag, _, place in page.elements if tag == "header" and "main" not in place]) == 1, where
        labels = [each.get("aria-label") for each in page.all("nav")]
        assert "Site" in labels, where
        assert len(labels) == len(set(labels)), where
        levels = [int(tag[1]) for tag, _, _ in page.elements if re.fullmatch("h[1-6]", tag)]
        assert all(below - above <= 1 for above, below in pairwise(levels)), where


def test_a_hostile_robot_is_shown_as_text_and_never_linked(pages: Mapping[str, bytes]) -> None:
    body = pages["hostile"].decode()
    page = Reader(body)
    assert "<script" not in body.partition("</head>")[2].lower()
    assert "\x00" not in body
    shown = HOSTILE.replace("\x00", "\u2400")
    assert sum(text.count(shown) for text in page.text) > 15
    assert [each["value"] for each in page.all("input") if each.get("name") == "data"] == [shown]
    assert "javascript:alert(1)" in page.text
    assert not [each for each in page.all("a") if re.match(r"\s*(javascript|data|vbscript):", each["href"] or "", re.I)]


def test_direction_overrides_stay_within_their_value(pages: Mapping[str, bytes]) -> None:
    """Each text of the robot is in a `bdi` (or an attribute), so that U+202E cannot reverse the text after it."""
    loose: list[tuple[str, ...]] = []

    class Finder(Reader):
        def handle_data(self, data: str) -> None:
            if "\u202e" in data and "bdi" not in self.open:
                loose.append(tuple(self.open))

    Finder(pages["hostile"].decode())
    blocks = {"title", "option", "button", "textarea", "pre", "h2", "p", "th", "legend"}
    assert not [place for place in loose if place[-1] not in blocks]


def test_the_policy_allows_no_foreign_script_and_no_foreign_place() -> None:
    policy = dict(each.split(" ", 1) for each in CONTENT_SECURITY_POLICY.split("; "))
    assert policy["default-src"] == "'none'"
    own = ("style-src", "img-src", "form-action", "script-src", "connect-src")
    assert {policy[name] for name in own} == {"'self'"}
    assert policy["base-uri"] == policy["frame-ancestors"] == "'none'"
    assert "unsafe" not in CONTENT_SECURITY_POLICY
