"""Rules for all documents of all robots: links resolve, syntaxes have equal triples, OpenAPI describes them."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable
from urllib.parse import urlsplit

import pytest
from pyoxigraph import CanonicalizationAlgorithm, Dataset, NamedNode, Quad, Triple

from rosld.ontology.modules import home_of_terms
from rosld.ontology.syntax import Syntax
from rosld.ontology.vocab import dcterms, rdfs, ros
from tests.crawl.description import Description
from tests.crawl.robots import ROBOTS
from tests.crawl.site import HTML, JSON, TURTLE, Answer, Site, hrefs, site

pytestmark = pytest.mark.slow

NAMES_OF_SCHEMES = ("basic_sc", "bearer_sc", "nosec_sc", "token_sc")
"""IRIs without documents that a Thing Description references."""
NO_STRING = ("base64Binary", "'elided': True")
"""Objects instead of a string that is not UTF-8 or too large, which descriptions mention only in words."""
GONE = (
    *("queries/bad", "mappings/bad", "data/log"),
    *("types/odd_msgs/msg/Odd", "shapes/odd_msgs/msg/Odd", "topics/odd?shape"),
)
"""Refused or deleted resources to which receipts link, and documents about an unknown type."""


@pytest.fixture(params=[pytest.param(name, marks=[pytest.mark.ros2] if name == "ros2" else []) for name in ROBOTS])
def robot(request: pytest.FixtureRequest) -> Site:
    return site(request.param)


def test_every_link_leads_somewhere(robot: Site) -> None:
    asked = {**robot.answers, **{url: found[HTML] for url, found in robot.others.items() if HTML in found}}
    dead = {url: answer.status for url, answer in asked.items() if answer.status >= 400 and not is_known(robot, answer)}
    assert not dead, dead
    assert len(asked) > 100
    shown = {href for found in robot.others.values() if HTML in found for href in hrefs(found[HTML])}
    assert len({href for href in shown if href.startswith(robot.base)} & asked.keys()) > 50


def is_known(robot: Site, answer: Answer) -> bool:
    """Whether a broken link is intended."""
    path = answer.url.removeprefix(robot.base)
    return (
        path.rpartition("/")[2] in NAMES_OF_SCHEMES
        or path in GONE
        or answer.status == 410
        or "is not on offer now" in answer.text
        or "There are no recordings to query" in answer.text
    )


def test_every_document_about_itself_has_one_label(robot: Site) -> None:
    found = {url: answer for url, answer in robot.documents.items() if not is_of_client(url.removeprefix(robot.base))}
    for url, answer in found.items():
        own = [each for each in answer.triples if each.subject == NamedNode(url)]
        labels = [each.object.value for each in own if each.predicate == rdfs.label]  # type: ignore[union-attr]
        assert not own or (len(labels) == 1 and labels[0].strip()), (url, labels)
        titles = {each.object.value for each in own if each.predicate == dcterms.title}  # type: ignore[union-attr]
        assert not titles or titles == set(labels), (url, titles, labels)
    assert len(found) > 50


def is_of_client(path: str) -> bool:
    """Whether a document says only what clients wrote, who may give it a label or not."""
    return path in ("data/", "mappings/", "cockpit/") or path.startswith(("data/", "mappings/", "shapes/slow"))


def test_every_document_is_a_page_for_a_browser(robot: Site) -> None:
    for url, found in robot.others.items():
        page = found[HTML]
        if url == f"{robot.base}.well-known/wot":
            continue  # a Thing Description
        assert page.headers["content-type"] == "text/html; charset=utf-8", url
        assert "default-src 'none'" in page.headers["content-security-policy"], url
        safe = r'<script (?:[^>]*src="/|type="application/ld\+json">)'
        assert page.text.count("<script") == len(re.findall(safe, page.text)), url
        assert "<nav" in page.text, url


def test_every_syntax_says_the_same(robot: Site) -> None:
    wrong, equal = [], 0
    for url, found in robot.others.items():
        if url not in robot.documents:
            continue
        before, after = robot.documents[url], found[TURTLE]
        predicates = [{each.predicate for each in turtle.triples} for turtle in (before, after)]
        said = canonical(after.triples)
        for syntax in Syntax:
            answer = found.get(syntax.media_type)
            if answer is None:
                continue
            if answer.status == 406 and syntax is Syntax.RDF_XML:
                continue  # XML has no such character
            if answer.media_type != syntax.media_type:
                wrong.append((url, syntax, answer.status, answer.media_type))
            elif state(answer) == state(after):
                equal += 1
                if canonical(answer.triples) != said:
                    wrong.append((url, syntax))
            elif {each.predicate for each in answer.triples} not in predicates:
                wrong.append((url, syntax, "at another time"))
    assert not wrong, wrong
    assert equal > 100


def state(answer: Answer) -> str:
    """Return the part of an entity-tag that is common to all syntaxes of one state."""
    return answer.headers.get("etag", "").partition(".")[0]


def canonical(triples: Iterable[Triple]) -> set[Quad]:
    dataset = Dataset(Quad(*triple) for triple in triples)
    dataset.canonicalize(CanonicalizationAlgorithm.UNSTABLE)
    return set(dataset)


def test_every_term_of_the_vocabulary_that_is_used_is_defined(robot: Site) -> None:
    terms = {term for answer in robot.documents.values() for triple in answer.triples for term in triple}
    used = {term.value for term in terms if isinstance(term, NamedNode) and term.value.startswith(ros.iri)}
    assert used - {ros.iri} <= home_of_terms().keys()
    assert len(used) > 50


def test_every_answer_is_one_that_the_description_tells_of(robot: Site) -> None:
    description = Description(json.loads(robot.answers[f"{robot.base}openapi.json"].text))
    answers = [*robot.answers.items(), *((url, each) for url, found in robot.others.items() for each in found.values())]
    wrong, judged = {}, 0
    for url, answer in answers:
        at = description.place(urlsplit(url).path, "GET")
        if at is None or answer.url.partition("?")[0] != url.partition("?")[0]:
            continue
        judged += 1
        told = description.disagreement(at, "GET", answer.status, answer.headers, answer.text)
        if told and not any(each in told for each in NO_STRING):
            wrong[url, answer.media_type] = told
    assert not wrong, "\n".join(f"{url}: {told}" for url, told in wrong.items())
    assert judged > 200
    assert {JSON, HTML} <= {each.media_type for _, each in answers}


def test_no_header_is_empty(robot: Site) -> None:
    answers = [*robot.answers.values(), *(each for found in robot.others.values() for each in found.values())]
    empty = [(each.url, name) for each in answers for name, value in each.headers.items() if not value]
    assert not empty, empty
