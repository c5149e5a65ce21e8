"""Fuzzing: every response is one that `/openapi.json` describes, without internal errors and endless waits.

Requests are generated from the description and, header by header and path by path, from common mistakes of clients.
Each run sends the same requests; `ROSLD_FUZZ_EXAMPLES` (100) sends more, `ROSLD_FUZZ_SEED` (0) others.
"""

from __future__ import annotations

import http.client
import json
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any
from urllib.parse import quote, urlsplit

import httpx
import pytest
import schemathesis
import schemathesis.specs.openapi.schemas  # now, and not deep in a test, where Python 3.11 may fail to rewrite it
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.errors import Unsatisfiable
from schemathesis.generation import GenerationMode

from tests.conformance.fuzzing import fuzzing
from tests.crawl.description import Description
from tests.server.conftest import Served, start_server
from tests.stopping import release

__all__ = ["start_server"]
pytestmark = pytest.mark.slow

JSON = ("Content-Type", "application/json")
PATIENCE = 15.0
"""Maximum duration of a response in seconds: a service has 10 at most."""

# The server and its possible responses


@dataclass(frozen=True)
class Answer:
    status: int
    headers: Mapping[str, str]
    body: bytes

    @property
    def media_type(self) -> str | None:
        stated = self.headers.get("content-type")
        return None if stated is None else stated.partition(";")[0]


class Connection(http.client.HTTPConnection):
    """A connection that sends any bytes, including paths and methods that no proper client sends."""

    def _validate_path(self, url: str) -> None:
        pass

    def _validate_method(self, method: str) -> None:
        pass

    def _encode_request(self, request: str) -> bytes:
        return request.encode("utf-8", "surrogatepass")


class Server:
    """A served aircraft, and a connection to it."""

    def __init__(self, served: Served) -> None:
        self.served = served
        self.url = served.url
        self._connection = Connection(urlsplit(self.url).netloc, timeout=PATIENCE)
        self.description = Description(json.loads(self.send("GET", "/openapi.json").body))

    def send(
        self, method: str, path: str, headers: Iterable[tuple[str, str]] = (), body: bytes | None = None
    ) -> Answer:
        """Return the response to a request; of an event stream the beginning."""
        pairs = list(headers)
        for last in (False, True):
            fresh = self._connection.sock is None
            try:
                return self._sent(method, path, pairs, body)
            except BaseException as error:
                self._connection.close()
                if fresh or last or not isinstance(error, ConnectionError):
                    raise
        raise AssertionError

    def _sent(self, method: str, path: str, headers: list[tuple[str, str]], body: bytes | None) -> Answer:
        given = {name.lower() for name, _ in headers}
        connection = self._connection
        connection.putrequest(method, path, skip_host="host" in given, skip_accept_encoding=True)
        if body is not None and "content-length" not in given:
            headers = [*headers, ("Content-Length", str(len(body)))]
        for name, value in headers:
            connection.putheader(name, value.encode("latin-1", "replace"))
        connection.endheaders(body)
        answer = connection.getresponse()
        found = {name.lower(): value for name, value in answer.getheaders()}
        if found.get("content-type", "").startswith("text/event-stream") and method != "HEAD":
            begun = answer.read1()
            connection.close()
            return Answer(answer.status, found, begun)
        return Answer(answer.status, found, answer.read())

    def judge(self, at: str, method: str, answer: Answer) -> None:
        """Assert that the description has this response to the operation at one of its paths."""
        sound(answer, method)
        told = self.description.disagreement(at, method, answer.status, answer.headers, answer.body)
        assert not told, told


def sound(answer: Answer, method: str) -> None:
    """Assert that the response is no internal error, and that a refusal has a reason."""
    refusals = (501, 503, 504) if method == "CONNECT" else (503, 504)
    assert answer.status < 500 or answer.status in refusals, f"{answer.status}: {answer.body[:500]!r}"
    if answer.status < 400 or method == "HEAD":
        return
    assert answer.headers.get("content-length") == str(len(answer.body))
    if answer.media_type == "application/problem+json":
        problem = json.loads(answer.body)
        assert problem["status"] == answer.status
        assert len(problem["detail"]) > 10
        assert "Traceback" not in problem["detail"]
    else:
        assert answer.body, f"a {answer.status} says nothing"


@pytest.fixture(scope="module")
def server(start_server: Callable[..., Served]) -> Server:
    return Server(start_server("aircraft", "--max-publish-rate", "100000"))


# Faults found this way, on an aircraft in its initial state


def test_a_write_that_was_done_is_told_as_done_also_to_who_accepts_nothing_that_is_offered(server: Server) -> None:
    server.send("DELETE", "/parameters/made_unseen")
    server.send("POST", "/resources/aircraft/start", [JSON], b"{}")
    for method, path, media_type, body, status in (
        ("POST", "/services/aircraft/get_power", "application/json", b"{}", 201),
        ("PUT", "/parameters/made_unseen", "application/json", b"1", 201),
        ("POST", "/data/", "text/turtle", b"", 201),
        ("POST", "/resources/aircraft/stop", "application/json", b"{}", 204),
        ("PATCH", "/parameters/cockpit/", "application/merge-patch+json", b'{"night": true}', 204),
    ):
        headers = [("Content-Type", media_type), ("Accept", "image/png"), ("Prefer", "return=representation")]
        answer = server.send(method, path, headers, body)
        assert (answer.status, answer.body) == (status, b""), path
        if status == 201:
            made = answer.headers["location"].removeprefix(server.url)
            assert server.send("GET", f"/{made}").status == 200


# Requests generated from the description

TYPES = "https://w3id.org/rosld/types/"
TERMS = st.sampled_from(
    [
        "<>", "<#message>", "<#request>", "<x>", "</topics/cockpit/display>", "[]", "_:b", "()", "(1 2)", '"a"', "1",
        "1e400", "-0.0", "true", '"x"^^<http://www.w3.org/2001/XMLSchema#byte>', '"a"@en', "'\\u0000'", "[ a <x> ]",
        "<http://www.w3.org/1999/02/22-rdf-syntax-ns#type>", "<https://w3id.org/rosld#value>",
        f"<{TYPES}std_msgs/msg/String>", f"<{TYPES}std_msgs/msg/String#data>", "<http://[>", "<http://a b>",
        "<http://www.w3.org/1999/02/22-rdf-syntax-ns#value>", "<http://www.w3.org/ns/ldp#contains>", "<urn:x:\u00e9>",
    ]
)  # fmt: skip
STATEMENTS = st.lists(st.tuples(TERMS, TERMS, TERMS).map(" ".join), max_size=4).map(
    lambda found: " ".join(f"{one} ." for one in found)
)
UPDATES = st.builds(
    "{} {{ {} }} {}".format,
    st.sampled_from(
        ["INSERT DATA", "DELETE DATA", "DELETE WHERE", "DELETE { ?s ?p ?o } WHERE", "WITH <x> DELETE", "CLEAR ALL ;"]
    ),
    STATEMENTS,
    st.sampled_from(["", ";", "WHERE { ?s ?p ?o }", "WHERE { GRAPH <x> { ?s ?p ?o } }", "USING <x> WHERE {}"]),
)
QUERIES = st.builds(
    "{} {{ {} }} {}".format,
    st.sampled_from(["SELECT * WHERE", "ASK", "CONSTRUCT WHERE", "DESCRIBE ?s WHERE", "SELECT (COUNT(*) AS ?n) WHERE"]),
    st.sampled_from(
        ["?s ?p ?o", "GRAPH ?g { ?s a ?o }", "SERVICE <x> { }", "{ ?s ?p 1 } UNION { }", "BIND(1/0 AS ?s)"]
    ),
    st.sampled_from(["", "LIMIT 3", "LIMIT -1", "ORDER BY ?s LIMIT 1", "GROUP BY ?s", "VALUES ?s { <x> }"]),
)
XML = st.sampled_from(
    [
        "", "<a/>", "<rdf:RDF xmlns:rdf='http://www.w3.org/1999/02/22-rdf-syntax-ns#'/>",
        "<?xml version='1.0'?><!DOCTYPE a [<!ENTITY b SYSTEM 'file:///etc/passwd'>]><a>&b;</a>",
        "<rdf:RDF xmlns:rdf='http://www.w3.org/1999/02/22-rdf-syntax-ns#'><rdf:Description rdf:about=''>"
        "<rdf:value>1</rdf:value></rdf:Description></rdf:RDF>",
    ]
)  # fmt: skip
JSON_LD = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | st.text(max_size=10),
    lambda inner: (
        st.lists(inner, max_size=3)
        | st.dictionaries(
            st.sampled_from(
                ["@id", "@type", "@value", "@context", "@graph", "@list", "@set", "@reverse", "x:y", "data", ""]
            ),
            inner,
            max_size=4,
        )
    ),
    max_leaves=10,
)


def octets(text: st.SearchStrategy[str]) -> st.SearchStrategy[bytes]:
    """Return the text as UTF-8, or arbitrary bytes."""
    return text.map(lambda one: one.encode("utf-8", "surrogatepass")) | st.binary(max_size=40)


BODIES: Mapping[str, st.SearchStrategy[bytes]] = {
    "text/turtle": octets(STATEMENTS | st.text(max_size=30)),
    "application/n-triples": octets(STATEMENTS),
    "application/n-quads": octets(STATEMENTS),
    "application/trig": octets(STATEMENTS | STATEMENTS.map("<x> {{ {} }}".format)),
    "text/n3": octets(STATEMENTS | STATEMENTS.map("{{ {0} }} => {{ {0} }} .".format)),
    "application/rdf+xml": octets(XML),
    "application/ld+json": octets(JSON_LD.map(json.dumps)),
    "application/sparql-update": octets(UPDATES),
    "application/sparql-query": octets(QUERIES),
}
for _media_type, _bodies in BODIES.items():
    schemathesis.openapi.media_type(_media_type, _bodies)


@pytest.fixture(scope="module")
def operations(server: Server) -> list[Any]:
    """Return the operations of the description, one for each group of identically described ones."""
    schema = schemathesis.openapi.from_dict(server.description.document)
    found: dict[tuple[object, ...], Any] = {}
    for each in schema.get_all_operations():
        operation = each.ok()
        bodies = tuple(body.media_type for body in operation.body)
        found.setdefault((operation.tags[0], operation.method, bodies, bool(operation.query)), operation)
    return list(found.values())


@pytest.mark.parametrize("mode", [GenerationMode.POSITIVE, GenerationMode.NEGATIVE], ids=["fitting", "unfitting"])
def test_what_the_description_makes_is_answered_as_it_tells(
    server: Server, operations: list[Any], mode: GenerationMode
) -> None:
    failed = []
    for operation in operations:
        if mode is GenerationMode.NEGATIVE and not (operation.body or operation.query):
            continue

        @fuzzing(0.02 if operation.body else 0.01)
        @given(case=operation.as_strategy(generation_mode=mode))
        def attempt(case: Any) -> None:
            answer = case.call(base_url=server.url.rstrip("/"), timeout=PATIENCE, stream=False)
            headers = {name.lower(): ", ".join(values) for name, values in answer.headers.items()}
            server.judge(case.path, case.method, Answer(answer.status_code, headers, answer.content))

        try:
            attempt()
        except Unsatisfiable:
            assert mode is GenerationMode.NEGATIVE  # any bytes are valid: those of a recording
        except Exception as error:
            failed.append(f"{operation.label}: {error}\n" + "\n".join(getattr(error, "__notes__", ())))
        if operation.tags[0] == "stop":
            with httpx.Client(base_url=server.url) as http:
                release(http).raise_for_status()
    assert not failed, "\n\n".join(failed)
    assert len(operations) > 40


# Headers, paths, methods and queries outside of any description

PRINTABLE = st.text(st.characters(min_codepoint=0x20, max_codepoint=0xFF, exclude_characters="\x7f"), max_size=40)
MEDIA_TYPES = st.sampled_from(
    [
        "text/turtle", "application/ld+json", "application/json", "application/n-quads", "application/rdf+xml",
        "text/html", "text/event-stream", "application/td+json", "application/sparql-results+json", "text/csv",
        "application/openapi+json", "application/problem+json", "*/*", "text/*", "*/json", "image/png", "text/n3",
        "application/merge-patch+json", "application/sparql-update", "application/sparql-query",
        "application/x-www-form-urlencoded", "multipart/form-data; boundary=x", "application/octet-stream",
    ]
)  # fmt: skip
ENDINGS = st.sampled_from(
    ["", ";q=0", ";q=1", ";q=0.5", ";q=2", ";q=x", "; charset=utf-8", ";charset=latin-1", ';profile="a, b"', ";", ";=",
     ' ;a="', ";q=0.0001"]
)  # fmt: skip
KINDS = st.builds("{}{}".format, MEDIA_TYPES, ENDINGS)
TAG_LISTS = st.sampled_from(
    ["*", '"x"', 'W/"x"', '"x", "y"', "x", '"', '"a"b"', ",", '"\u00e9"', "*, *", '"x.ttl"', '"' + "a" * 5000 + '"', ""]
)
DATES = st.sampled_from(["Sat, 21 Nov 2026 05:00:00 GMT", "yesterday", "Mon, 99 Foo 0000 99:99:99 GMT"])
PREFERENCES = st.sampled_from(
    [
        "return=minimal", "return=representation", "return=representation; include=\"http://www.w3.org/ns/ldp#Prefer\"",
        'return=representation; omit="http://www.w3.org/ns/ldp#PreferContainment x:y"', "respond-async", "wait=0",
        "wait=-1", "wait=99999999999999999999", 'return="minimal', "return=minimal, return=representation", ";;,,=",
        "handling=strict", 'return=representation; include="\u00e9"',
    ]
)  # fmt: skip
LINKS = st.sampled_from(
    [
        '<http://www.w3.org/ns/ldp#BasicContainer>; rel="type"', '<http://www.w3.org/ns/ldp#NonRDFSource>; rel=type',
        '<http://www.w3.org/ns/ldp#DirectContainer>; rel="type"', '<http://www.w3.org/ns/ldp#Nothing>; rel="type"',
        '<x>; rel="type", <y>; rel="type"', "<>", "<", '<a b>; rel="type"', "<x>; rel", '<x>; rel="type',
        '<http://www.w3.org/ns/ldp#Resource>; rel="type"; anchor="x"', '<\u00e9>; rel="type"',
    ]
)  # fmt: skip
SLUGS = st.sampled_from(
    ["a", "", ".", "..", "../..", "a/b", "%2e%2e", "%", "a b", "\u00e9\u00ff", "a" * 3000, "x?y", "x#y", "~", ".meta",
     "con", "a.ttl", "-", "\u00a0"]
)  # fmt: skip
RANGES = st.sampled_from(
    ["bytes=0-0", "bytes=0-", "bytes=-1", "bytes=5-1", "bytes=999999999999999999999-", "bytes=0-1,3-4", "bytes=", "x=1",
     "bytes=a-b", "bytes=" + "0-0," * 500, "items=0-1"]
)  # fmt: skip
HEADERS: Mapping[str, st.SearchStrategy[str]] = {
    "Accept": st.lists(KINDS, max_size=3).map(", ".join),
    "Accept-Charset": st.sampled_from(["utf-8", "latin-1;q=1, *;q=0", ""]),
    "Accept-Encoding": st.sampled_from(["gzip", "identity;q=0", "*;q=0", "br, zstd"]),
    "Accept-Language": st.sampled_from(["de", "*;q=0", "x-y-z"]),
    "Content-Type": KINDS,
    "Content-Encoding": st.sampled_from(["gzip", "identity", "deflate, gzip", "", "x"]),
    "Content-Language": st.just("de"),
    "If-Match": TAG_LISTS,
    "If-None-Match": TAG_LISTS,
    "If-Modified-Since": DATES,
    "If-Unmodified-Since": DATES,
    "If-Range": TAG_LISTS,
    "Prefer": PREFERENCES,
    "Link": LINKS,
    "Slug": SLUGS,
    "Range": RANGES,
    "Origin": st.sampled_from(["null", "http://evil.example", "x", "http://127.0.0.1", ""]),
    "Referer": st.sampled_from(["http://evil.example/", "x", "http://[", "/topics/"]),
    "Sec-Fetch-Site": st.sampled_from(["cross-site", "same-origin", "none", "x"]),
    "Access-Control-Request-Method": st.sampled_from(["PUT", "BREW", ""]),
    "Idempotency-Key": st.sampled_from(["a", '"a"', "", "a" * 5000]),
    "Last-Event-ID": TAG_LISTS,
    "Expect": st.sampled_from(["100-continue", "x"]),
    "Forwarded": st.just("host=evil.example;proto=https"),
    "X-Forwarded-Host": st.just("evil.example"),
    "X-HTTP-Method-Override": st.just("DELETE"),
    "Upgrade": st.sampled_from(["websocket", "h2c", "x"]),
    "Connection": st.sampled_from(["close", "keep-alive", "Upgrade", "x"]),
    "TE": st.just("trailers"),
    "Cookie": PRINTABLE,
}
FIELDS = st.lists(
    st.sampled_from(sorted(HEADERS)).flatmap(
        lambda name: st.tuples(st.just(name), HEADERS[name] if name == "Cookie" else HEADERS[name] | PRINTABLE)
    ),
    max_size=4,
)
WRITES = (
    ("PUT", "/topics/cockpit/display", "application/json", b'{"data": "fuzz"}'),
    ("PATCH", "/topics/cockpit/display", "application/merge-patch+json", b'{"data": "fuzz"}'),
    ("POST", "/services/aircraft/get_power", "application/json", b"{}"),
    ("POST", "/services/aircraft/engine/set_speed", "application/json", b'{"data": 1}'),
    ("PUT", "/parameters/fuzzed", "application/json", b"1"),
    ("PATCH", "/parameters/", "application/merge-patch+json", b'{"fuzzed": 2}'),
    ("POST", "/parameters/", "application/json", b"1"),
    ("DELETE", "/parameters/fuzzed", "application/json", b""),
    ("PUT", "/resources/cockpit/night", "application/json", b"true"),
    ("POST", "/resources/aircraft/start", "application/json", b"{}"),
    ("PATCH", "/resources/cockpit/", "application/merge-patch+json", b'{"night": false}'),
    ("PUT", "/mappings/fuzzed", "text/turtle", b""),
    ("POST", "/mappings/", "text/turtle", b""),
    ("DELETE", "/mappings/fuzzed", "text/turtle", b""),
    ("POST", "/sparql", "application/sparql-query", b"ASK {}"),
    ("POST", "/data/", "text/turtle", b"<> <x:p> 1 ."),
    ("PUT", "/data/fuzzed", "text/turtle", b"<> <x:p> 1 ."),
    ("PUT", "/data/fuzzed.bin", "application/octet-stream", b"\x00\xff"),
    ("PUT", "/data/fuzzed/", "text/turtle", b""),
    ("POST", "/data/fuzzed/", "text/plain", b"fuzz"),
    ("PATCH", "/data/fuzzed", "application/sparql-update", b"INSERT DATA { <> <x:p> 2 }"),
    ("DELETE", "/data/fuzzed", "text/turtle", b""),
)
READS = (
    "/", "/topics/", "/topics/aircraft/engine/speed", "/topics/cockpit/display", "/services/aircraft/start",
    "/parameters/", "/parameters/cockpit/night", "/resources/aircraft/", "/resources/aircraft/power",
    "/resources/aircraft/start", "/mappings/", "/queries/graph", "/queries/inventory", "/sparql", "/openapi.json",
    "/.well-known/wot", "/style.css", "/types/std_msgs/msg/String", "/calls/", "/ontology", "/shapes/limits", "/data/",
    "/data/fuzzed", "/data/fuzzed.bin", "/data/fuzzed/", "/bags/", "/nodes/aircraft",
)  # fmt: skip


def judged(server: Server, method: str, path: str, answer: Answer) -> None:
    """Assert that the response is a described one or, for other paths, that it is sound."""
    at = server.description.place(path.partition("?")[0], method)
    if at is None:
        sound(answer, method)
    else:
        server.judge(at, method, answer)


def test_whatever_the_headers_are_the_request_is_answered(server: Server) -> None:
    reads = st.tuples(st.sampled_from(["GET", "GET", "HEAD", "OPTIONS"]), st.sampled_from(READS), st.none(), st.none())

    @fuzzing(3)  # many headers, many paths
    @given(request=reads | st.sampled_from(WRITES), headers=FIELDS)
    def attempt(request: tuple[str, str, str | None, bytes | None], headers: list[tuple[str, str]]) -> None:
        method, path, media_type, body = request
        if media_type and not any(name == "Content-Type" for name, _ in headers):
            headers = [("Content-Type", media_type), *headers]
        judged(server, method, path, server.send(method, path, headers, body))

    attempt()


SEGMENTS = st.sampled_from(
    [
        "", ".", "..", "~", "~.", "~~", "%", "%2", "%zz", "%00", "%0a", "%2e", "%2e%2e", "%2f", "%5c", "%25", "%ff",
        "%c0%af", "%ed%a0%80", "%F0%9F%A4%96", "a", "a b", "a;b", "a:b", "a@b", "*", "'", '"', "<", ">", "\\", "|", "^",
        "{name}", "$", "&", "=", "+", "\u00e9", "\u202e", "a" * 300, "a%20b", "_hidden", "0", "-1", "1e400", "aircraft",
        "cockpit", "display", "msg", "std_msgs", "String", "String_Request", "messages", "mapping", "limits", "wot",
        "fuzzed", ".meta", "fuzzed.meta", "index.html", "etc", "passwd",
    ]
)  # fmt: skip
ROOMS = st.sampled_from(
    ["topics", "services", "nodes", "parameters", "resources", "mappings", "queries", "types", "shapes", "bags",
     "calls", "cockpit", "data", "sparql", "ontology", "openapi.json", "style.css", ".well-known", "",
    "%74opics", "TOPICS", "graphs"]
)  # fmt: skip
PATHS = st.builds(
    lambda room, segments, end: "/".join(("", room, *segments)) + end,
    ROOMS,
    st.lists(SEGMENTS | st.text(max_size=5).map(lambda text: quote(text, safe="", errors="replace")), max_size=5),
    st.sampled_from(["", "/", "//", "?", "#", "%"]),
)
METHODS = st.sampled_from(["GET", "HEAD", "OPTIONS", "PUT", "POST", "PATCH", "DELETE"])


def test_whatever_the_path_and_the_method_are_the_request_is_answered(server: Server) -> None:
    words = st.text("ABCDEFGHIJKLMNOPQRSTUVWXYZ!#$%&'*+-.^_`|~0189", min_size=1, max_size=20)
    odd = st.sampled_from(["TRACE", "CONNECT", "PROPFIND", "BREW", "LOCK", "M-SEARCH", "get", "Put", "PRI"]) | words

    @fuzzing(2)
    @given(
        method=METHODS | odd,
        path=PATHS | st.sampled_from((*READS, "*")),
        accept=st.sampled_from(["*/*", "text/html", "text/turtle", "application/rdf+xml"]),
    )
    def attempt(method: str, path: str, accept: str) -> None:
        body = b"" if method in ("PUT", "POST", "PATCH") else None
        answer = server.send(method, path, [("Accept", accept), JSON], body)
        sound(answer, method)

    attempt()


NAMES = st.sampled_from(
    ["format", "field", "after", "timeout", "rate", "hash", "page", "hidden", "defaults", "latch", "query", "update",
     "default-graph-uri", "named-graph-uri", "name", "seconds", "topic", "limit", "x", "", "q", "%", "data.0"]
)  # fmt: skip
VALUES = st.sampled_from(
    ["", "ttl", "json", "html", "td", "nq", "rdf", "x", "0", "1", "-1", "1e400", "NaN", "99999999999999999999999",
     "true", "TRUE", "data", "data.0", "data.data", "..", "%00", "%ff", "%", "+", "*", "ASK{}",
    "SELECT * {?s ?p ?o} LIMIT 1",
     "/topics/x", "http://[", "a" * 3000, "\u00e9"]
)  # fmt: skip
STRINGS = st.lists(
    st.builds("{}={}".format, NAMES, VALUES | VALUES.map(lambda text: quote(text, safe=""))) | NAMES, max_size=4
).map("&".join)


def test_whatever_the_query_is_it_is_answered(server: Server) -> None:
    @fuzzing(2)
    @given(method=METHODS, path=st.sampled_from(READS), query=STRINGS)
    def attempt(method: str, path: str, query: str) -> None:
        body = b"{}" if method in ("PUT", "POST", "PATCH") else None
        query = query.replace(" ", "%20")
        judged(server, method, path, server.send(method, f"{path}?{query}", [JSON], body))

    attempt()


def test_the_robot_is_there_after_all_that(server: Server) -> None:
    answer = server.send("GET", "/resources/aircraft/power", [("Accept", "application/json")])
    assert answer.status == 200, answer.body
