"""The documentation at `/docs/`: every page is there with all its links, and is found by words, without a network."""

from __future__ import annotations

import re
from pathlib import Path

import html5rdf  # type: ignore[import-untyped]
import httpx
import pytest

from rosld.server.html.site import CONTENT_SECURITY_POLICY

DOCS = Path(__file__).parents[2] / "docs"
PAGE = {"Accept": "text/html"}
TARGET = re.compile(r'(?:href|src)="([^"]*)"')


def paths() -> list[str]:
    names = (str(path.relative_to(DOCS)).removesuffix(".md") for path in sorted(DOCS.rglob("*.md")))
    return ["" if name == "README" else name for name in names]


@pytest.mark.slow
def test_every_link_within_the_documentation_leads_to_a_file_and_a_heading(http: httpx.Client) -> None:
    pages = {f"/docs/{path}": http.get(f"/docs/{path}", headers=PAGE) for path in paths()}
    files, broken = set(), []
    for path, page in pages.items():
        assert page.status_code == 200, path
        assert page.headers["content-security-policy"] == CONTENT_SECURITY_POLICY
        for link in TARGET.findall(page.text):
            target, _, anchor = link.partition("#")
            if not target or target.startswith("/docs/"):
                there = pages.get(target or path)
                if there is None:
                    files.add(target)
                elif anchor and f'id="{anchor}"' not in there.text:
                    broken.append((path, link))
    assert not broken
    assert all(http.get(each).status_code == 200 for each in files)
    assert "/docs/tutorial/pilot.py" in files


def test_pages_are_valid_html_whose_headings_and_pictures_are_local(http: httpx.Client) -> None:
    for path in ("", "how-to/", "how-to/proxy", "reference/ontology", "?q=docker"):
        text = http.get(f"/docs/{path}", headers=PAGE).text
        parser = html5rdf.HTMLParser()
        parser.parse(text)
        assert not parser.errors, path
        ids = re.findall(r' id="([^"]*)"', text)
        assert len(ids) == len(set(ids))
        assert text.count("<h1") == 1
        assert all(each.startswith("/") for each in re.findall(r'<(?:img|script)[^>]* src="([^"]*)"', text))


def test_a_page_is_markdown_for_those_who_do_not_prefer_html(http: httpx.Client) -> None:
    answer = http.get("/docs/how-to/proxy")
    assert answer.headers["content-type"] == "text/markdown; charset=utf-8"
    assert answer.text == (DOCS / "how-to" / "proxy.md").read_text("utf-8")
    again = http.get("/docs/how-to/proxy", headers={"If-None-Match": answer.headers["etag"]})
    assert again.status_code == 304
    assert http.get("/docs/how-to/proxy?format=html").headers["content-type"] == "text/html; charset=utf-8"
    assert http.get("/docs/how-to/proxy", headers={"Accept": "text/turtle"}).status_code == 406
    assert "[Behind a proxy](proxy)" in http.get("/docs/how-to/").text


@pytest.mark.parametrize(
    ("path", "url"),
    [("docs", "docs/"), ("docs/README.md", "docs/"), ("docs/how-to", "docs/how-to/")]
    + [(f"docs/{name}.md", f"docs/{name}") for name in ("glossary", "how-to/ros1")],
)
def test_names_of_files_redirect_to_pages(http: httpx.Client, path: str, url: str) -> None:
    answer = http.get(path, follow_redirects=False)
    assert answer.status_code == 308
    assert answer.headers["location"] == f"{http.base_url}{url}"


@pytest.mark.parametrize("path", ["none", "how-to/none", "how-to/ros1/", "none/", "how-to/README.md"])
def test_a_missing_page_is_404_with_the_search(http: httpx.Client, path: str) -> None:
    answer = http.get(f"docs/{path}")
    assert answer.status_code == 404
    assert "/docs/?q=" in answer.json()["detail"]


def test_sections_are_found_by_words(http: httpx.Client) -> None:
    found = TARGET.findall(http.get("/docs/?q=SUBSCRIBER+quality+of+service", headers=PAGE).text)
    assert "/docs/how-to/trouble#a-topic-has-no-message" in found
    first = [each for each in TARGET.findall(http.get("/docs/?q=trouble", headers=PAGE).text) if "/docs/how-to" in each]
    assert first[0] == "/docs/how-to/trouble"
    assert "No page contains" in http.get("/docs/?q=zq7x9", headers=PAGE).text
    assert "&lt;script&gt;" in http.get("/docs/?q=%3Cscript%3E", headers=PAGE).text


def test_every_page_of_the_robot_and_its_errors_lead_there(http: httpx.Client) -> None:
    assert 'href="/docs/"' in http.get("/topics/", headers=PAGE).text
    assert 'href="/docs/how-to/trouble"' in http.get("/topics/none", headers=PAGE).text
