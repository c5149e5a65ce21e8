"""Bodies: RDF from clients, parsed safely into an index.

Bodies are untrusted. Deep nesting overflows the parser's stack, which kills the whole process, so depth is checked
first. Nothing is ever fetched, so JSON-LD must contain its context. Every fault is a `BodyError` with its position.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from typing import TypeAlias

import orjson
from msgspec import Struct
from pyoxigraph import BlankNode, DefaultGraph, Literal, NamedNode, Quad, RdfFormat, Triple, parse, serialize

from rosld.ontology.charsets import UnknownCharset, decode_xml
from rosld.ontology.vocab import rdf

Term: TypeAlias = NamedNode | BlankNode | Literal | Triple
Subject: TypeAlias = NamedNode | BlankNode | Triple
Properties: TypeAlias = Mapping[NamedNode, list[Term]]

MAX_DEPTH = 128
"""Maximum depth of nesting."""
_LEAST_EXPANDED, _EXPANSION = 16 * 1024 * 1024, 150
"""Maximum size in bytes of the terms of a body when expanded: at least, and per byte of the body.

Each use of a prefix of 100 kB adds 100 kB. An RDF list of digits, the tersest legitimate body, expands to 132 bytes per
byte.
"""
_SHORT = 2000
"""Bytes of a body that cannot exceed the limit of expansion. Writing its quads takes half as long as parsing them."""

_FORMATS = {
    "text/turtle": RdfFormat.TURTLE,
    "application/ld+json": RdfFormat.JSON_LD,
    "application/n-triples": RdfFormat.N_TRIPLES,
    "application/rdf+xml": RdfFormat.RDF_XML,
    "text/n3": RdfFormat.N3,
    "application/n-quads": RdfFormat.N_QUADS,
    "application/trig": RdfFormat.TRIG,
}
MEDIA_TYPES = tuple(_FORMATS)
"""Media types that `parse_body` accepts."""


class BodyError(ValueError):
    """An invalid body; `line` and `column` count from 1 and are None if the position is unknown."""

    def __init__(self, words: str, line: int | None = None, column: int | None = None) -> None:
        place = "" if line is None else f"line {line}, column {column}: "
        super().__init__(place + words)
        self.words = words
        self.line = line
        self.column = column

    def __reduce__(self) -> tuple[object, ...]:
        """Make the error picklable, for worker processes."""
        return BodyError, (self.words, self.line, self.column)


class UnsupportedCharset(BodyError):
    """A body in an unsupported character encoding."""


class ExpandedBodyError(BodyError):
    """A body whose terms are too long when expanded."""

    def __reduce__(self) -> tuple[object, ...]:
        return ExpandedBodyError, (self.words,)


class RdfBody(Struct, frozen=True):
    """The triples of a body: `subjects` maps each subject to its predicates, and these to their objects.

    `size` is the number of triples. Duplicates are retained, except in the result of `objects`.
    """

    subjects: Mapping[Subject, Properties]
    size: int

    def properties(self, subject: Term) -> Properties:
        """Return the properties of `subject`; empty for a literal or an unknown node."""
        return _NOTHING if isinstance(subject, Literal) else self.subjects.get(subject, _NOTHING)

    def objects(self, subject: Term, predicate: NamedNode) -> list[Term]:
        """Return the objects of one predicate of `subject`."""
        return list(dict.fromkeys(self.properties(subject).get(predicate, ())))

    def instances(self, type: NamedNode) -> list[Subject]:
        """Return the subjects of a type."""
        return [subject for subject in self.subjects if type in self.objects(subject, rdf.type)]

    def literals(self) -> Iterator[Literal]:
        """Yield all literals."""
        for properties in self.subjects.values():
            for objects in properties.values():
                yield from (each for each in objects if isinstance(each, Literal))

    def roots(self) -> list[Subject]:
        """Return the subjects that are not objects of any triple."""
        inner = {each for properties in self.subjects.values() for objects in properties.values() for each in objects}
        return [subject for subject in self.subjects if subject not in inner]


_NOTHING: Properties = {}
_DEFAULT_GRAPHS_OF_JENA = tuple(NamedNode(f"urn:x-arq:{name}") for name in ("DefaultGraph", "DefaultGraphNode"))


def parse_body(data: bytes, media_type: str, base: str) -> RdfBody:
    """Return the triples of `data`, with relative IRIs resolved against `base` (absolute).

    Of a dataset, the default graph and the graph named `base` are used; other graphs are ignored. Raises BodyError
    for invalid UTF-8, nesting deeper than `MAX_DEPTH`, a reference that would have to be fetched, or a missing
    `media_type`; ValueError for a media type not in `MEDIA_TYPES`. The caller checks the size.
    """
    form = _form(media_type)
    with _parser_errors():
        return index_quads(_quads(data, form, base), base)


def parse_dataset(data: bytes, media_type: str, base: str) -> dict[str, list[Triple]]:
    """Return the graphs of `data` by name. Raises as `parse_body`, and BodyError for a triple in the default graph."""
    graphs: dict[str, list[Triple]] = {}
    for quad in parse_quads(data, media_type, base):
        if not isinstance(quad.graph_name, NamedNode):
            raise BodyError(f"{quad.triple} is not in a graph with an IRI: name its graph")
        graphs.setdefault(quad.graph_name.value, []).append(quad.triple)
    return graphs


def parse_quads(data: bytes, media_type: str, base: str) -> list[Quad]:
    """Return the quads of `data` with new labels of blank nodes. Raises as `parse_body`."""
    form = _form(media_type)
    with _parser_errors():
        return list(_quads(data, form, base, relabelled=True))


def parse_triples(data: bytes, media_type: str, base: str) -> list[Triple]:
    """Return the triples that `read_ntriples` reads."""
    return [quad.triple for quad in parse(read_ntriples(data, media_type, base), RdfFormat.N_TRIPLES)]


def read_ntriples(data: bytes, media_type: str, base: str) -> bytes:
    """Return the triples of `data` in order, as N-Triples, of the graph named `base` alone. Raises as `parse_body`.

    Blank nodes get globally unique labels, as labels are local to their document (RDF 1.1, 3.4).
    """
    form = _form(media_type)
    with _parser_errors():
        quads = _quads(data, form, base, relabelled=True)
        triples = _of_graph(quads, base) if form.supports_datasets else quads
        return serialize(triples, format=RdfFormat.N_TRIPLES) or b""


@contextmanager
def _parser_errors() -> Iterator[None]:
    try:
        yield
    except SyntaxError as error:
        raise _syntax_error(error) from error
    except BodyError:
        raise
    except ValueError as error:
        raise BodyError(str(error)) from error


def _of_graph(quads: Iterable[Quad], base: str) -> Iterator[Triple]:
    own = _own_graphs(base)
    for quad in quads:
        if quad.graph_name not in own:
            raise _strange(quad.graph_name)
        yield quad.triple


def _own_graphs(base: str) -> tuple[DefaultGraph | NamedNode, ...]:
    """Return the names of the single graph of a resource: none, its own, and those that mean none in Jena's output."""
    return (DefaultGraph(), NamedNode(base), *_DEFAULT_GRAPHS_OF_JENA)


def _strange(graph: object) -> BodyError:
    return BodyError(f"the graph {graph} does not belong to this resource: PUT it to its own URL")


def _form(media_type: str) -> RdfFormat:
    form = _FORMATS.get(media_type)
    if form is None:
        raise ValueError(f"{media_type} is not a supported RDF syntax: {', '.join(MEDIA_TYPES)}")
    return form


def _quads(data: bytes, form: RdfFormat, base: str, *, relabelled: bool = False) -> Iterator[Quad]:
    """Return the quads of a body after the safety checks, in the parser's order; `relabelled`: with new blank nodes."""
    if form is RdfFormat.RDF_XML:
        data = _xml(data)
    data = data.removeprefix(b"\xef\xbb\xbf")
    _check_utf8(data)
    if form is RdfFormat.JSON_LD:
        if data.lstrip(b" \t\r\n")[:1] not in (b"{", b"[", b""):  # the parser accepts it as an empty document
            raise BodyError("a JSON-LD document must be an object or an array (JSON-LD 1.1, 9)")
        check_json_depth(data)
        _check_contexts(data, base)
    elif form is RdfFormat.RDF_XML:
        _check_xml(data)
    else:
        _check_depth(data, _TURTLE_TOKENS, b"[({<")
    quads = parse(data, form, base_iri=base, rename_blank_nodes=relabelled)
    return quads if len(data) < _SHORT else _limited(quads, len(data))


def _limited(quads: Iterable[Quad], size: int) -> Iterator[Quad]:
    """Yield the quads of a body of `size` bytes. Raises ExpandedBodyError once their terms are too long."""
    left = expansion_limit(size)
    for quad in quads:
        left -= len(str(quad))
        if left < 0:
            raise expanded_body_error(size)
        yield quad


def expansion_limit(size: int) -> int:
    """Return the maximum size in bytes of the expanded terms of a body of `size` bytes."""
    return _LEAST_EXPANDED + _EXPANSION * size


def expanded_body_error(size: int) -> ExpandedBodyError:
    """Return the error for a body of `size` bytes that exceeds that maximum."""
    words = f"Written out, the IRIs of these {size} bytes take more than {expansion_limit(size)} bytes"
    return ExpandedBodyError(f"{words}: shorten the prefixes and bases, or send several parts.")


def index_triples(triples: Iterable[Triple]) -> RdfBody:
    """Return the triples by subject and predicate."""
    subjects: dict[Subject, dict[NamedNode, list[Term]]] = {}
    size = 0
    for subject, predicate, object in triples:
        subjects.setdefault(subject, {}).setdefault(predicate, []).append(object)
        size += 1
    return RdfBody(subjects, size)


def index_quads(quads: Iterable[Quad], base: str) -> RdfBody:
    """Return the triples of the default graph and of the graph named `base`, by subject and predicate."""
    graphs = _own_graphs(base)
    subjects: dict[Subject, dict[NamedNode, list[Term]]] = {}
    size = 0
    for subject, predicate, object, graph in quads:
        if graph in graphs:
            subjects.setdefault(subject, {}).setdefault(predicate, []).append(object)
            size += 1
    return RdfBody(subjects, size)


def _syntax_error(error: SyntaxError) -> BodyError:
    """Return the message of the parser without the position, which the error has separately."""
    words = re.sub(r"^Parser error at [^:]*: ", "", str(error.msg))
    return BodyError(words, error.lineno, error.offset)


def _check_utf8(data: bytes) -> None:
    try:
        data.decode()
    except UnicodeDecodeError as error:
        raise error_at(data, error.start, f"byte 0x{data[error.start]:02X} is not UTF-8") from error


def error_at(data: bytes, position: int, words: str) -> BodyError:
    """Return a BodyError at a byte of `data`."""
    line = data.count(b"\n", 0, position) + 1
    return BodyError(words, line, position - data.rfind(b"\n", 0, position))


# Nesting

_JSON_TOKENS = re.compile(rb'"[^"\\]*(?:\\.[^"\\]*)*"|(?P<open>[\[{])|(?P<close>[\]}])|(?P<broken>")', re.DOTALL)
_TURTLE_TOKENS = re.compile(
    rb'"""[^"\\]*(?:(?:\\.|""?(?!"))[^"\\]*)*"""'
    rb"|'''[^'\\]*(?:(?:\\.|''?(?!'))[^'\\]*)*'''"
    rb"|(?P<broken>\"\"\"|''')"
    rb'|"[^"\\\r\n]*(?:\\.[^"\\\r\n]*)*"'
    rb"|'[^'\\\r\n]*(?:\\.[^'\\\r\n]*)*'"
    rb"|#[^\r\n]*|\\."
    rb"|(?P<open><<|[\[({])|(?P<close>>>|[\])}])"
    rb'|<(?![=\-])[^\x00-\x20<>"{}|^`\\]*(?:\\[uU][^\x00-\x20<>"{}|^`\\]*)*>'
    rb"|(?P<quote>[\"'])",
    re.DOTALL,
)
"""Strings, comments, escapes and IRIs, which are skipped. `<=` and `<-` are not: in N3 they are no IRIs."""


def check_json_depth(data: bytes) -> None:
    """Raise BodyError for JSON nested deeper than `MAX_DEPTH`."""
    _check_depth(data, _JSON_TOKENS, b"[{")


def check_turtle_depth(data: bytes) -> None:
    """Raise BodyError for invalid UTF-8, and for Turtle or N3 nested deeper than `MAX_DEPTH`."""
    _check_utf8(data)
    _check_depth(data, _TURTLE_TOKENS, b"[({<")


def _check_depth(data: bytes, tokens: re.Pattern[bytes], openers: bytes) -> None:
    """Raise BodyError for text nested too deeply. Text with few brackets in all needs no check."""
    if sum([data.count(opener) for opener in openers]) <= MAX_DEPTH:
        return
    depth = 0
    for token in tokens.finditer(data):
        kind = token.lastgroup
        if kind == "open":
            depth += 1
            if depth > MAX_DEPTH:
                raise _too_deep(data, token.start())
        elif kind == "close":
            depth = max(0, depth - 1)
        elif kind is not None:
            raise error_at(data, token.start(), "this string does not end")


def _too_deep(data: bytes, position: int) -> BodyError:
    return error_at(data, position, f"nested deeper than {MAX_DEPTH} levels, which is more than any ROS message needs")


# JSON-LD


def _check_contexts(data: bytes, base: str) -> None:
    """Raise BodyError for a context that would have to be fetched (JSON-LD 1.1 3.1), naming its URL.

    Raises ExpandedBodyError if the strings may expand to too much: the parser holds all of them before the first quad.
    """
    longest, seen = len(base), set[bytes]()
    for context in _contexts(data) if b"context" in data or b"import" in data or b"\\" in data else ():
        if isinstance(context, str):
            raise BodyError(
                f"the JSON-LD context {context} is not known, and contexts are not fetched: include the context itself"
            )
        text = orjson.dumps(context)
        if text not in seen:
            seen.add(text)
            longest += _longest_iri(context)
    if longest * (data.count(b'"') // 2) > expansion_limit(len(data)):
        raise expanded_body_error(len(data))


def _contexts(data: bytes) -> Iterator[str | dict[str, object]]:
    """Yield the contexts of a JSON-LD document: objects, and the URLs of remote contexts."""
    try:
        waiting: list[object] = [orjson.loads(data)]
    except orjson.JSONDecodeError as error:
        raise BodyError(f"this is not JSON: {error.msg}", error.lineno, error.colno) from error
    while waiting:
        value = waiting.pop()
        if isinstance(value, list):
            waiting += value
        elif isinstance(value, dict):
            context = value.get("@context")
            for each in (*(context if isinstance(context, list) else (context,)), value.get("@import")):
                if isinstance(each, str | dict):
                    yield each
            waiting += value.values()


def _longest_iri(context: Mapping[str, object]) -> int:
    """Return an upper bound of the characters that a context adds to an IRI: terms may be prefixes of each other."""
    terms: dict[str, str] = {}
    for term, value in context.items():
        iri = value.get("@id") if isinstance(value, dict) else value
        if isinstance(iri, str):
            terms[term] = iri
    lengths: dict[str, int] = {}
    for each in terms:
        chain: dict[str, None] = {}
        term = each
        while term in terms and term not in lengths and term not in chain:
            chain[term] = None
            term = terms[term].partition(":")[0]
        length = lengths.get(term, 0)
        for term in reversed(chain):
            length = lengths[term] = length + len(terms[term])
    return max(lengths.values(), default=0) + lengths.get("@vocab", 0) + lengths.get("@base", 0)


# RDF/XML

_XML_TOKENS = re.compile(
    rb"(?P<skip><!--.*?-->|<!\[CDATA\[.*?\]\]>|<\?.*?\?>)"
    rb"|(?P<broken><!--|<!\[CDATA\[|<\?)"
    rb"|(?P<declaration><!)"
    rb"|(?P<close></)"
    rb"|(?P<empty><[^<>\"']*(?:(?:\"[^\"]*\"|'[^']*')[^<>\"']*)*/>)"
    rb"|(?P<open><[^<>\"']*(?:(?:\"[^\"]*\"|'[^']*')[^<>\"']*)*>)"
    rb"|(?P<tag><)",
    re.DOTALL,
)


def _xml(data: bytes) -> bytes:
    """Return an XML document in UTF-8, whatever encoding it declares. Raises UnsupportedCharset and BodyError."""
    try:
        return decode_xml(data)
    except UnknownCharset as error:
        raise UnsupportedCharset(str(error)) from error
    except UnicodeDecodeError as error:
        raise error_at(data, error.start, f"byte 0x{data[error.start]:02X} is not {error.encoding}") from error


def _check_xml(data: bytes) -> None:
    """Raise BodyError for declarations (which define entities), and for elements nested too deeply."""
    depth = 0
    for token in _XML_TOKENS.finditer(data):
        kind = token.lastgroup
        if kind == "open":
            depth += 1
            if depth > MAX_DEPTH:
                raise _too_deep(data, token.start())
        elif kind == "close":
            depth = max(0, depth - 1)
        elif kind == "declaration":
            raise error_at(data, token.start(), "RDF/XML with a DOCTYPE is not supported: omit the declaration")
        elif kind in ("broken", "tag"):
            raise error_at(data, token.start(), f"what begins here with {token[0].decode()} does not end")


# Plain JSON


def parse_json(data: bytes) -> object:
    """Return the value of a JSON text, with exact integers of any size.

    Raises BodyError for invalid UTF-8, nesting deeper than `MAX_DEPTH`, invalid JSON (including NaN and Infinity), and
    duplicate keys in an object.
    """
    data = data.removeprefix(b"\xef\xbb\xbf")
    _check_utf8(data)
    check_json_depth(data)
    try:
        return _JSON.decode(data.decode())
    except json.JSONDecodeError as error:
        raise BodyError(f"this is not JSON: {error.msg}", error.lineno, error.colno) from error
    except BodyError:
        raise
    except ValueError as error:
        raise BodyError(f"this JSON cannot be read: {error}") from error


def _once(pairs: list[tuple[str, object]]) -> dict[str, object]:
    members = dict(pairs)
    if len(members) < len(pairs):
        seen: set[str] = set()
        twice = next(key for key, _ in pairs if key in seen or seen.add(key))  # type: ignore[func-returns-value]
        raise BodyError(f"the key {twice!r} occurs twice in one object")
    return members


def _no_number(token: str) -> object:
    name = {"Infinity": "INF", "-Infinity": "-INF"}.get(token, token)
    raise BodyError(f'{token} is not a number in JSON: write the string "{name}"')


_JSON = json.JSONDecoder(object_pairs_hook=_once, parse_constant=_no_number)
