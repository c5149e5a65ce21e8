"""Everything that a robot serves: crawled once per content of the repository, and cached in `.crawl/`.

Tests of documents call `site("aircraft")`. The first call starts the robot (`robots.py`) and follows every link;
others, in any process of any run, wait and read the same responses. Shapes and markup are checked on the first
documents of each kind (`of_each_kind`), as the others only differ in names.
"""

from __future__ import annotations

import html
import json
import re
import sysconfig
from collections import defaultdict, deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache, cached_property
from pathlib import Path
from urllib.parse import urljoin

import httpx
from pyoxigraph import Literal, NamedNode, RdfFormat, Triple, parse

from rosld.ontology.syntax import Syntax
from rosld.ontology.vocab import rdf, xsd
from rosld.server.http.fields import parse_links
from rosld.shapes.message import SHACL_SHACL
from tests.crawl.robots import ROBOTS
from tests.interop.stamps import made_once

ROOT = Path(__file__).parents[2]
FOLDER = ROOT / ".crawl"
TURTLE, JSON, HTML = "text/turtle", "application/json", "text/html"
OTHERS = (*(syntax.media_type for syntax in Syntax if syntax is not Syntax.TURTLE), JSON, TURTLE, HTML)
"""Further representations of the first document of each kind, including Turtle once more."""
CONFORMS_TO, CONSTRAINED_BY = "http://purl.org/dc/terms/conformsTo", "http://www.w3.org/ns/ldp#constrainedBy"
BESIDE = ("stop", "status", "channels/", "sparql", ".well-known/", "find?q=engine", "openapi.json")
"""Paths to which not every robot links."""
NO_DOCUMENTS = ("?default", "?all", "?field=", "?format=", "&format=")
"""Parts of URLs that are no documents of one resource."""
MAX_URLS = 3_000


@dataclass(frozen=True)
class Answer:
    """The response to a GET; the text is empty for other bodies."""

    url: str
    status: int
    headers: Mapping[str, str]
    text: str

    @property
    def media_type(self) -> str:
        return self.headers.get("content-type", "").partition(";")[0]

    def links(self, rel: str | None = None) -> list[str]:
        """Return the targets of its Link headers, of all relations or of one."""
        return [link.target for link in parse_links(self.headers.get("link", "")) if rel in (None, link.rel)]

    @cached_property
    def triples(self) -> Sequence[Triple]:
        """The triples in the response, with separate blank nodes and without graph names."""
        syntax = RdfFormat.from_media_type(self.media_type)
        assert syntax is not None, f"{self.url} is {self.media_type}"
        quads = parse(self.text, format=syntax, base_iri=self.url, rename_blank_nodes=True)
        return list(dict.fromkeys(quad.triple for quad in quads))


@dataclass
class Site:
    """The responses of a robot: to requests for Turtle by URL, and to those for other media types."""

    base: str
    answers: dict[str, Answer] = field(default_factory=dict)
    others: dict[str, dict[str, Answer]] = field(default_factory=lambda: defaultdict(dict))

    @cached_property
    def documents(self) -> dict[str, Answer]:
        """The documents in Turtle, by the URLs after redirects."""
        return {each.url: each for each in self.answers.values() if (each.status, each.media_type) == (200, TURTLE)}

    def of_each_kind(self, most: int = 1) -> list[str]:
        """Return at most this number of documents with the same properties of instances of the same classes.

        For shapes only classes count: validating all shapes of shapes takes a hundred times as long as all other
        documents.
        """
        kinds: dict[frozenset[object], list[str]] = defaultdict(list)
        for url, answer in self.documents.items():
            classes = {triple.object for triple in answer.triples if triple.predicate == rdf.type}
            linked = {document(shape) for shape in answer.links(CONFORMS_TO)}
            is_shape = document(SHACL_SHACL) in linked
            properties = set() if is_shape else {triple.predicate for triple in answer.triples}
            kinds[frozenset([*classes, *properties, *linked])].append(url)
        return [url for urls in kinds.values() for url in urls[:most]]


@cache
def site(name: str) -> Site:
    """Return the responses of a robot of `robots.ROBOTS`, crawling it first if necessary."""
    folder = FOLDER / name
    with made_once(folder, _inputs()) as is_there:
        if not is_there:
            with ROBOTS[name](folder) as http:
                found = _Crawl(http)
                found.run()
            (folder / "answers.json").write_text(json.dumps([str(http.base_url), *found.kept]))
    base, *kept = json.loads((folder / "answers.json").read_text())
    read = Site(base)
    for url, accept, *answer in kept:
        if accept == TURTLE and url not in read.answers:
            read.answers[url] = Answer(*answer)
        else:
            read.others[url][accept] = Answer(*answer)
    return read


def _inputs() -> Iterator[Path]:
    """Yield everything that the responses depend on: the code, the robots, and the installed libraries."""
    for folder in (
        "adapters",
        "ontology",
        "queries",
        "server",
        "shapes",
        "tests/crawl",
        "tests/adapters",
        "tests/ros2",
    ):
        for path in sorted((ROOT / folder).rglob("*")):
            if path.is_file() and "__pycache__" not in path.parts and not path.name.startswith("test_"):
                yield path
    yield from sorted(Path(sysconfig.get_path("purelib")).glob("*.dist-info/RECORD"))


class _Crawl:
    """A crawl along all links of a server."""

    def __init__(self, http: httpx.Client) -> None:
        self.kept: list[tuple[object, ...]] = []
        self._http = http
        self._site = Site(str(http.base_url))
        self._known: set[str] = set()
        self._ahead: deque[str] = deque()

    def run(self) -> None:
        base = self._site.base
        self._add([base, *(base + path for path in BESIDE)])
        while self._ahead:
            url = self._ahead.popleft()
            answer = self._site.answers[url] = self._get(url, TURTLE)
            self._add([answer.url, *answer.links()])
            if (answer.status, answer.media_type) == (200, TURTLE):
                self._add(linked(answer.triples))
        for url in self._site.of_each_kind():
            for media_type in OTHERS:
                answer = self._get(url, media_type)
            self._add(hrefs(answer))
        while self._ahead:
            self._get(self._ahead.popleft(), HTML)

    def _get(self, url: str, accept: str) -> Answer:
        got = self._http.get(url, headers={"Accept": f"{accept}, */*;q=0.1"}, follow_redirects=True)
        is_text = got.headers.get("content-type", "").startswith(("application/", "text/"))
        is_text &= "octet-stream" not in got.headers.get("content-type", "")
        answer = Answer(str(got.url), got.status_code, dict(got.headers), got.text if is_text else "")
        self.kept.append((url, accept, *vars(answer).values()))
        return answer

    def _add(self, urls: Iterable[str]) -> None:
        """Add these URLs to the crawl, if they are documents of this server."""
        for url in map(document, urls):
            is_new = url.startswith(self._site.base) and url not in self._known
            if is_new and not any(mark in url for mark in NO_DOCUMENTS):
                self._known.add(url)
                self._ahead.append(url)
        assert len(self._known) <= MAX_URLS, f"more than {MAX_URLS} URLs"


def hrefs(page: Answer) -> list[str]:
    """Return the URLs that a page links to, without fragments."""
    found = re.findall(r'<a [^>]*?href="([^"]+)"', page.text)
    return [document(urljoin(page.url, html.unescape(each))) for each in found]


def document(url: str) -> str:
    """Return a URL without its fragment."""
    return url.partition("#")[0]


def linked(graph: Iterable[Triple]) -> Iterable[str]:
    """Yield the URLs that triples mention; of those in literals, none that a query derives from another."""
    for term in (term for triple in graph for term in (triple.subject, triple.object)):
        is_url = isinstance(term, Literal) and term.datatype == xsd.anyURI and "?" not in term.value
        if isinstance(term, NamedNode) or is_url:
            yield term.value
