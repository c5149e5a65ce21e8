"""A server full of secrets that can be recognised, and a walk over everything it says to an agent.

Whatever the tests put there has a name or a value that begins with `zebra`, or is one of `NUMBERS`.
"""

from __future__ import annotations

import http.client
import json
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any
from urllib.parse import quote, unquote, urlsplit

import httpx
import websockets.sync.client
from pyoxigraph import NamedNode, RdfFormat, parse

from tests.server.auth.conftest import TURTLE, Guarded, token

ADMIN = "zebraadmin"
NUMBERS = ("765.25", "4321.125", "7654.375")
"""A limit, the distance of a goal, and a measured value, each in any notation that begins so."""
MARKER = re.compile("|".join(["zebra[a-z]*", *(re.escape(each) for each in NUMBERS)]), re.IGNORECASE)
SYNTAXES = (
    "text/turtle", "application/ld+json", "application/n-triples", "application/rdf+xml", "text/n3",
    "application/n-quads", "application/trig", "application/json", "text/html", "application/td+json",
)  # fmt: skip
PREFIXES = """
@prefix map: <https://w3id.org/rosld/mapping#> . @prefix ex: <http://example.org/> .
@prefix sh: <http://www.w3.org/ns/shacl#> . @prefix rdf: <http://www.w3.org/1999/02/22-rdf-syntax-ns#> .
@prefix rdfs: <http://www.w3.org/2000/01/rdf-schema#> .
"""
MAPPING = """
<#aircraft> a map:ComplexResource ; map:path "/aircraft/" ; rdfs:label "The aircraft" ;
  map:property [ map:predicate ex:power ; map:member "power" ; map:writableWhen <#zebracondition> ] ,
    [ map:predicate ex:zebraspeed ; map:name "zebraspeed" ; map:member "/aircraft/engine/speed" ] ,
    [ map:predicate ex:zebraparameter ; map:name "zebraparameter" ; map:member "/zebratree/zebraleaf" ] ;
  map:action [ map:relation ex:zebrastart ; map:name "zebrastart" ; map:service "start" ] ,
    [ map:relation ex:zebraturn ; map:name "zebraturn" ; map:service "engine/set_direction" ;
      map:availableWhen <#zebracondition> ] ;
  map:link [ map:relation ex:zebralink ; map:target "/zebrahidden/" ] ;
  map:stop [ map:publish "/zebratopic" ; map:content '{"data": "zebrastopcontent"}' ] .
<#hidden> a map:ComplexResource ; map:path "/zebrahidden/" ; rdfs:label "zebralabel" ;
  map:property [ map:predicate ex:zebraother ; map:member "/zebratree/zebraleaf" ; map:name "zebraother" ] .
<#zebracondition> a sh:NodeShape ; map:about "/zebratree/zebraleaf" ; sh:property [ sh:path rdf:value ;
  sh:hasValue "zebranever" ; sh:message "zebramessage" ] .
"""
LIMITS = """
<#slow> a sh:NodeShape ; sh:targetNode <../resources/aircraft/engine/speed> ;
  sh:property [ sh:path rdf:value ; sh:maxInclusive 765.25 ] .
"""
QUERY = "# zebrapurpose of this query.\n# @param zebraname string x -- zebraabout\nSELECT ?s { ?s ros:name ?zebraname }"
STRING = "<#message> a <https://w3id.org/rosld/types/std_msgs/msg/String> ; <https://w3id.org/rosld/types/std_msgs/msg/String#data> "  # noqa: E501


def fill(admin: httpx.Client) -> None:
    """Put secrets everywhere."""

    def do(method: str, path: str, status: int, **how: Any) -> httpx.Response:
        answer = admin.request(method, path, **how)
        assert answer.status_code == status, (method, path, answer.status_code, answer.text)
        return answer

    do("POST", "/services/aircraft/start", 201)
    do("PUT", "/topics/zebratopic", 201, content=f'{STRING} "zebravalue" .', headers=TURTLE)
    do("PUT", "/parameters/zebratree/zebraleaf", 201, json="zebraleafvalue")
    do("PUT", "/parameters/open/number", 201, json=1)
    do("PUT", "/parameters/open/zebranumber", 201, json=7654.375)
    do("PUT", "/data/zebradocument", 201, content="<> <http://example.org/zebrasays> 'zebratext' .", headers=TURTLE)
    do("PUT", "/data/zebrabox/zebrafile", 201, content=b"zebracontent", headers={"Content-Type": "text/plain"})
    do("PUT", "/data/open/plan", 201, content="<> <http://e.x/p> 1 ; <http://e.x/q> </data/zebradocument> .",
       headers=TURTLE)  # fmt: skip
    do("PUT", "/data/open/zebraplan", 201, content="<> <http://e.x/p> 'zebraplanned' .", headers=TURTLE)
    do("PUT", "/data/zebragone", 201, content="<> <http://e.x/p> 'zebragonetext' .", headers=TURTLE)
    do("DELETE", "/data/zebragone", 204)
    do("PUT", "/queries/zebraquery", 201, content=QUERY, headers={"Content-Type": "application/sparql-query"})
    do("PUT", "/shapes/zebralimits", 201, content=PREFIXES + LIMITS, headers=TURTLE)
    do("DELETE", "/mappings/aircraft", 204)
    do("PUT", "/mappings/zebramapping", 201, content=PREFIXES + MAPPING, headers=TURTLE)
    do("POST", "/services/aircraft/set_power", 201, json={"data": "on"})
    do("POST", "/actions/aircraft/fly", 201, json={"distance": 4321.125})
    do("POST", "/topics/zebratopic?rate=1&lease=5&then=none", 201, json={"data": "zebraheld"})
    do("PUT", "/parameters/zebrarefused", 400, content=b"{zebrabad", headers={"Content-Type": "application/json"})


@dataclass(frozen=True)
class Answer:
    """What came back for a request."""

    status: int
    headers: Mapping[str, str]
    text: str

    @property
    def said(self) -> str:
        """Head and body."""
        return "".join(f"{name}: {value}\n" for name, value in self.headers.items()) + self.text


class Asking:
    """One agent's connection, which costs a request a fraction of a millisecond."""

    def __init__(self, guarded: Guarded, agent: str) -> None:
        self._parts = urlsplit(guarded.url)
        self._headers = {"Authorization": f"Bearer {token(agent)}"}
        self._connection: http.client.HTTPConnection | None = None

    def __call__(self, method: str, path: str, body: bytes | None = None, **headers: str) -> Answer:
        fields = {**self._headers, **{name.replace("_", "-"): value for name, value in headers.items()}}
        for attempt in (0, 1):
            connection = self._connection
            if connection is None:
                connection = self._connection = http.client.HTTPConnection(self._parts.netloc, timeout=20)
            try:
                connection.request(method, path, body, fields)
                answer = connection.getresponse()
                text = answer.read().decode("utf-8", "replace")
                return Answer(answer.status, {k.lower(): v for k, v in answer.getheaders()}, text)
            except (http.client.HTTPException, OSError):
                connection.close()
                self._connection = None
                if attempt:
                    raise
        raise AssertionError


def markers(said: str, asked: str = "") -> set[str]:
    """The secrets in what was said, but for those that the request itself named."""
    named = {each.lower() for each in MARKER.findall(unquote(asked))}
    return {each.lower() for each in MARKER.findall(unquote(said)) + MARKER.findall(said)} - named


def everywhere(guarded: Guarded, limit: int = 400) -> list[str]:
    """The paths of everything that the administrator is led to, and of what is not there."""
    ask = Asking(guarded, ADMIN)
    found: dict[str, None] = {}
    waiting = [
        "/",
        "/data/zebragone",
        "/data/zebranever",
        "/topics/zebranever",
        "/parameters/zebranever",
        "/zebranever",
    ]
    waiting += json.loads(ask("GET", "/openapi.json").text)["paths"]
    while waiting and len(found) < limit:
        path = waiting.pop(0)
        if path in found or "{" in path:
            continue
        found[path] = None
        answer = ask("GET", path, Accept="application/n-triples")
        if answer.status != 200 or "n-triples" not in answer.headers["content-type"]:
            continue
        for triple in parse(answer.text, RdfFormat.N_TRIPLES):
            for term in (triple.subject, triple.object):
                if isinstance(term, NamedNode) and term.value.startswith(guarded.url):
                    waiting.append("/" + term.value[len(guarded.url) :].partition("#")[0])
    return list(found)


def said_to(
    guarded: Guarded, agent: str, paths: list[str], own: tuple[str, ...] = ()
) -> Iterator[tuple[str, str, Answer]]:
    """Yield what an agent is told at these paths: the request in words, the same, and the answer."""
    ask = Asking(guarded, agent)

    def asked(method: str, path: str, body: bytes | None = None, **headers: str) -> tuple[str, str, Answer]:
        words = f"{method} {path} {headers.get('Accept', '')} {headers.get('Content_Type', '')}"
        return words, path + (body or b"").decode("utf-8", "replace"), ask(method, path, body, **headers)

    for number, path in enumerate(paths):
        first = asked("GET", path)
        yield first
        if first[2].status in (401, 403, 404) and path not in own:  # refused alike: another of them each time
            method, body, kind = OTHERS[(number + len(agent)) % len(OTHERS)]
            yield asked(method, path, body, Content_Type=kind)
            yield asked("GET", f"{path}?format=html")
            continue
        yield asked("OPTIONS", path)
        yield asked("HEAD", path)
        for method, body, kind in BAD:
            yield asked(method, path, body, Content_Type=kind, Accept="text/turtle" if "json" in kind else "")
        for syntax in SYNTAXES:
            yield asked("GET", path, Accept=syntax)
        for query in QUERIES:
            yield asked("GET", f"{path}?{query}")
        if "etag" in first[2].headers:
            tag = quote(first[2].headers["etag"])
            yield asked("GET", f"{path}?after={tag}&timeout=0.01")
            yield asked("GET", f"{path}?after=nonsense&timeout=0.01", Accept="application/json")


BAD = (
    ("PUT", b"{nonsense", "application/json"),
    ("PATCH", b"<> <", "application/sparql-update"),
    ("PATCH", b'{"a": {"b": null}}', "application/merge-patch+json"),
    ("POST", b"nonsense", "application/x-nothing"),
    ("POST", b'{"data": 1}', "application/json"),
    ("DELETE", None, ""),
)
OTHERS = (*BAD, ("OPTIONS", None, ""), ("HEAD", None, ""))
QUERIES = (
    "format=zzz", "format=td", "hidden=true", "page=0", "page=1", "page=:a", "page=2:a", "field=data", "field=zz",
    "hash=0", "keep=true", "timeout=x", "after=x&timeout=0.01",
)  # fmt: skip


VIEWS = ("/sparql", "/graphs", "/openapi.json", "/.well-known/**", "/channels/**")
"""What says of everything what a reader may see of it."""
SELECTS = (
    "SELECT * { ?s ?p ?o }",
    "SELECT * { GRAPH ?g { ?s ?p ?o } }",
    "SELECT * { GRAPH ?g {} }",
    "SELECT (GROUP_CONCAT(STR(?o)) AS ?t) (COUNT(*) AS ?n) { GRAPH ?g { ?s ?p ?o } }",
    "SELECT * { ?s ?p ?o FILTER(CONTAINS(LCASE(STR(?o)), 'zebra')) }",
    "SELECT * { ?x a ros:ComplexResource ; ?p ?o }",
    "SELECT * { GRAPH ?g { ?x a ros:ComplexResource ; ?p ?o } }",
    "SELECT * { ?x a ros:Property ; ?p ?o }",
    "SELECT * { ?x td:hasPropertyAffordance ?a . ?a ?p ?o }",
    "SELECT * { ?x td:hasActionAffordance ?a . ?a ?p ?o }",
    "SELECT * { ?x td:hasForm ?f . ?f hctl:hasTarget ?o }",
    "SELECT * { ?x a ros:Parameter ; ?p ?o }",
    "SELECT * { ?x a ros:Stop ; ?p ?o . ?o ?q ?r }",
    "SELECT * { ?x a ros:Write ; ?p ?o }",
    "CONSTRUCT { ?s ?p ?o } { GRAPH ?g { ?s ?p ?o } }",
    "CONSTRUCT { ?s ?p ?o } { ?s ?p ?o }",
    "DESCRIBE ?x { ?x ros:name ?n }",
)
OF_GRAPHS = (
    "SELECT * {{ GRAPH <{0}> {{ ?s ?p ?o }} }}",
    "SELECT * FROM <{0}> {{ ?s ?p ?o }}",
    "SELECT * FROM NAMED <{0}> {{ GRAPH ?g {{ ?s ?p ?o }} }}",
    "DESCRIBE <{0}>",
    "ASK {{ ?s ?p <{0}> }}",
)
UPDATES = (
    "INSERT DATA {{ GRAPH <{0}> {{ <{0}> <http://e.x/p> 1 }} }}",
    "DELETE WHERE {{ GRAPH <{0}> {{ ?s ?p ?o }} }}",
    "INSERT {{ GRAPH <http://e.x/g> {{ ?s ?p ?o }} }} WHERE {{ GRAPH <{0}> {{ ?s ?p ?o }} }}",
    "COPY <{0}> TO <http://e.x/g>",
    "DROP GRAPH <{0}>",
    "CLEAR GRAPH <{0}>",
    "LOAD <{0}> INTO GRAPH <http://e.x/g>",
)
RESULTS = ("application/sparql-results+json", "application/sparql-results+xml", "text/csv", "text/html")


def streamed_to(guarded: Guarded, agent: str, paths: list[str]) -> Iterator[tuple[str, str, Answer]]:
    """The first event of each stream that an agent may read, and what comes of subscribing; as `said_to`."""
    ask = Asking(guarded, agent)
    headers = {"Authorization": f"Bearer {token(agent)}", "Accept": "text/event-stream"}
    for path in paths:
        for kind in ("WebSocketChannel2023", "StreamingHTTPChannel2023"):
            wish = {
                "@context": ["https://www.w3.org/ns/solid/notifications-context/v1"],
                "type": f"http://www.w3.org/ns/solid/notifications#{kind}",
                "topic": guarded.url + path[1:],
                "state": "outdated",
            }
            body = json.dumps(wish).encode()
            answer = ask("POST", f"/channels/{kind}", body, Content_Type="application/ld+json")
            yield f"{kind} {path}", path, answer
            if kind.startswith("WebSocket") and answer.status in (200, 201):
                frame = first_frame(json.loads(answer.text)["receiveFrom"])
                yield f"frame of {kind} {path}", path, Answer(200, {}, frame)
        if ask("HEAD", path).status != 200:
            continue
        for syntax in ("ttl", "json", "html"):
            with httpx.stream("GET", guarded.url + path[1:], params={"format": syntax}, headers=headers) as stream:
                if not stream.headers.get("content-type", "").startswith("text/event-stream"):
                    continue
                lines = []
                for line in stream.iter_lines():
                    lines.append(line)
                    if line.startswith("data:") and lines[0].startswith(("id:", "event:", "retry:", ":")):
                        break
                yield f"stream of {path} as {syntax}", path, Answer(200, dict(stream.headers), "\n".join(lines))


def first_frame(url: str) -> str:
    """What a WebSocket is told first: that the state is another than its subscriber had."""
    with websockets.sync.client.connect(url) as socket:
        return str(socket.recv(timeout=60))


def asked_of_the_dataset(guarded: Guarded, agent: str, paths: list[str]) -> Iterator[tuple[str, str, Answer]]:
    """Everything that an agent is told by queries, updates and the graph store; as `said_to`."""
    ask, base = Asking(guarded, agent), guarded.url.rstrip("/")

    def query(text: str, accept: str) -> tuple[str, str, Answer]:
        kind = "application/sparql-query"
        return f"{text} {accept}", text, ask("POST", "/sparql", text.encode(), Content_Type=kind, Accept=accept)

    for number, text in enumerate(SELECTS):
        kinds = RESULTS if text.startswith("SELECT") else ("application/n-triples", "application/ld+json")
        yield query(text, kinds[(number + len(agent)) % len(kinds)])
    for place, path in enumerate(paths):
        for text in OF_GRAPHS:
            yield query(text.format(base + path), "*/*")
        for number, text in enumerate(UPDATES):
            told = text.format(base + path)
            dry = "?dry-run=true" if (place + number) % 2 else ""
            answer = ask("POST", f"/sparql{dry}", told.encode(), Content_Type="application/sparql-update")
            yield f"{told} {dry}", told, answer
        for method in ("GET", "HEAD", "OPTIONS", "DELETE"):
            graph = f"/graphs?graph={quote(base + path, safe='')}"
            yield f"{method} {graph}", graph, ask(method, graph)
        for method in ("PUT", "POST"):
            yield f"{method} {graph}", graph, ask(method, graph, b"<> <", Content_Type="text/turtle")
    for syntax in SYNTAXES[:2]:
        yield "GET /graphs?default", "", ask("GET", "/graphs?default", Accept=syntax)
