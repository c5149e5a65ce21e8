"""Bodies: those that are accepted, and the rejection of all others, with the position, before they can do harm."""

from __future__ import annotations

import json
import time
from collections.abc import Callable

import pyoxigraph as ox
import pytest

from rosld.ontology.body import (
    MAX_DEPTH,
    MEDIA_TYPES,
    BodyError,
    ExpandedBodyError,
    parse_body,
    parse_json,
    read_ntriples,
)

D = "http://127.0.0.1:8080/topics/t"
SUBJECT, PREDICATE = ox.NamedNode(D + "#message"), ox.NamedNode("http://x/p")
RDF = "http://www.w3.org/1999/02/22-rdf-syntax-ns#"
ONE = {
    "text/turtle": "<#message> <http://x/p> 1 .",
    "text/n3": "<#message> <http://x/p> 1 .",
    "application/trig": f"<{D}> {{ <#message> <http://x/p> 1 }} <http://other> {{ <#message> <http://x/p> 2 }}",
    "application/n-triples": f'<{D}#message> <http://x/p> "1"^^<http://www.w3.org/2001/XMLSchema#integer> .',
    "application/n-quads": f'<{D}#message> <http://x/p> "1"^^<http://www.w3.org/2001/XMLSchema#integer> <{D}> .\n'
    f"<{D}#message> <http://x/p> <{D}> <http://other> .",
    "application/ld+json": '{"@id":"#message","http://x/p":1}',
    "application/rdf+xml": f'<r:RDF xmlns:r="{RDF}" xmlns:x="http://x/"><r:Description r:about="#message">'
    '<x:p r:datatype="http://www.w3.org/2001/XMLSchema#integer">1</x:p></r:Description></r:RDF>',
}


@pytest.mark.parametrize("media_type", MEDIA_TYPES)
def test_every_syntax_gives_one_index_with_relative_iris_resolved(media_type: str) -> None:
    body = parse_body(ONE[media_type].encode(), media_type, D)
    assert body.size == 1
    one = ox.Literal("1", datatype=ox.NamedNode("http://www.w3.org/2001/XMLSchema#integer"))
    assert body.objects(SUBJECT, PREDICATE) == [one]
    assert body.roots() == [SUBJECT]


@pytest.mark.parametrize(
    ("media_type", "text", "words"),
    [
        ("text/turtle", b"<#message> a\n  <http://x", "line 2, column"),
        ("text/turtle", b"<#m> <http://x/p> 1 .\n\xff", "line 2, column 1: byte 0xFF is not UTF-8"),
        ("text/turtle", b'<#m> <http://x/p> "a\nb" .', "line 1"),
        ("text/turtle", b"<#m> u:p 1 .", "line 1"),
        ("application/n-triples", b"<a> <b> <c> .", "line 1"),
        ("application/ld+json", b'{"a": 1', "line 1"),
        ("application/ld+json", b"\xef\xbb\xbf[", "line 1"),
        ("application/ld+json", b'"a"', "must be an object or an array"),
        ("application/ld+json", b'{"@context": {"@vocab": 5}}', ""),
        ("application/rdf+xml", b"<a>", ""),
        ("application/rdf+xml", b"<a", "line 1, column 1: what begins here with < does not end"),
        ("application/rdf+xml", b"<!-- ", "does not end"),
        ("application/rdf+xml", b'<?xml version="1.0" encoding="utf-16"?><a/>', "declares UTF-16"),
        ("application/rdf+xml", b'<!DOCTYPE a [<!ENTITY b "c">]><a/>', "DOCTYPE"),
        ("application/rdf+xml", b'<a><!ENTITY b "c"></a>', "DOCTYPE"),
    ],
)
def test_a_malformed_body_is_refused_with_its_place(media_type: str, text: bytes, words: str) -> None:
    with pytest.raises(BodyError) as refused:
        parse_body(text, media_type, D)
    assert words in str(refused.value)


@pytest.mark.parametrize(
    ("text", "url"),
    [
        (b'{"@context": "https://schema.org", "a": 1}', "https://schema.org"),
        (b'{"@context": [{"a": "http://a"}, "http://x/c"]}', "http://x/c"),
        (b'{"a": [{"@context": "relative.jsonld"}]}', "relative.jsonld"),
        (b'{"@context": {"@import": "http://x/i"}}', "http://x/i"),
        (b'{"@context": {"t": {"@id": "http://t", "@context": "http://x/scoped"}}}', "http://x/scoped"),
        (b'{"@conte\\u0078t": "http://x/escaped"}', "http://x/escaped"),
    ],
)
def test_a_context_that_would_have_to_be_fetched_is_named(text: bytes, url: str) -> None:
    with pytest.raises(BodyError, match=url):
        parse_body(text, "application/ld+json", D)


DEEP = 30_000
NESTS = [
    ("text/turtle", "<#m> <http://x/p> " + "[ <http://x/p> " * DEEP + "1" + "]" * DEEP + "."),
    ("text/turtle", "<#m> <http://x/p> " + "(" * DEEP + ")" * DEEP + "."),
    ("text/turtle", "<#m> <http://x/p> " + "<<( <#a> <#b> " * DEEP + "1" + ")>>" * DEEP + "."),
    ("text/turtle", "<#m> <http://x/p\\'> " + "(" * DEEP),
    ("text/n3", "<#m> " + "<=" + "((" * DEEP + ">"),
    ("text/n3", "{" * DEEP),
    ("application/trig", "<#m> <http://x/p> " + "[ <http://x/p> " * DEEP),
    ("application/n-triples", "<http://m> <http://x/p> " + "<<( <http://a> <http://b> " * DEEP),
    ("application/ld+json", '{"http://x/p":' * DEEP + "1" + "}" * DEEP),
    ("application/ld+json", "[" * DEEP),
    ("application/rdf+xml", "<a>" * DEEP + "</a>" * DEEP),
    ("application/rdf+xml", "<a x='>'>" * DEEP),
]


@pytest.mark.parametrize(("media_type", "text"), NESTS, ids=[f"{kind}-{text[:32]}" for kind, text in NESTS])
def test_deep_nesting_is_refused_before_any_parser_sees_it(media_type: str, text: str) -> None:
    with pytest.raises(BodyError, match="nested deeper than 128 levels"):
        parse_body(text.encode(), media_type, D)


BRACKETS = "[({<" * MAX_DEPTH
HARMLESS = [
    f'<#m> <http://x/p> "{BRACKETS}" .',
    f"<#m> <http://x/p> '{BRACKETS}' .",
    f'<#m> <http://x/p> """a"b""c\n{BRACKETS}""" .',
    f"<#m> <http://x/p> '''{BRACKETS}''' .",
    f"# it's {BRACKETS}\n<#m> <http://x/p> 1 .",
    "<#m> <http://x/p> " + ", ".join([f"<#{'(' * (i % 50)}{i}>" for i in range(200)]) + " .",
    "<#m> <http://x/p> " + ", ".join(["( 1 )"] * 200) + " .",
    "<#m> <http://x/p> " + "( " * MAX_DEPTH + ") " * MAX_DEPTH + " .",
]


@pytest.mark.parametrize("text", HARMLESS, ids=[text[:40] for text in HARMLESS])
def test_brackets_that_nest_nothing_are_no_harm(text: str) -> None:
    assert parse_body(text.encode(), "text/turtle", D).size >= 1


@pytest.mark.parametrize(
    ("media_type", "piece"),
    [
        ("text/turtle", b'"""'),
        ("text/turtle", b"[]'''a"),
        ("text/turtle", b"[]<a"),
        ("text/turtle", b'[]"\\"'),
        ("application/ld+json", b'[]"a'),
        ("application/rdf+xml", b"<!--"),
        ("application/rdf+xml", b"<a b='"),
        ("application/rdf+xml", b"<a b='' "),
        ("application/rdf+xml", b"<![CDATA["),
    ],
)
def test_what_never_ends_is_refused_in_time(media_type: str, piece: bytes) -> None:
    start = time.process_time()
    with pytest.raises(BodyError):
        parse_body(piece * 100_000, media_type, D)
    assert time.process_time() - start < 5


def test_json_keeps_every_integer_exact() -> None:
    assert parse_json(b"[18446744073709551615, -9223372036854775808]") == [2**64 - 1, -(2**63)]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (b'{"a": NaN}', 'write the string "NaN"'),
        (b"[-Infinity]", 'write the string "-INF"'),
        (b'{"a": 1, "a": 2}', "the key 'a' occurs twice"),
        (b'{"a": {"b": 1, "b": 1}}', "the key 'b' occurs twice"),
        (b'{"a": ', "line 1, column 7"),
        (b"", "line 1, column 1"),
        (b"{}{}", "Extra data"),
        (b"'a'", "this is not JSON"),
        (b"\xff", "not UTF-8"),
        (b"[" * 100_000, "nested deeper than 128 levels"),
        (b'{"a":' * 100_000, "nested deeper than 128 levels"),
        (b"1" * 100_000, "cannot be read"),
    ],
)
def test_what_is_no_json_is_refused(text: bytes, words: str) -> None:
    with pytest.raises(BodyError) as refused:
        parse_json(text)
    assert words in str(refused.value)


USES = 10_000
PREFIX = f"http://x/{'a' * 20_000}/"
EXPANDING = [
    *(
        (kind, f"@prefix x: <{PREFIX}> . x: x: x:{',x:' * USES} .")
        for kind in ("text/turtle", "text/n3", "application/trig")
    ),
    ("text/turtle", f"@base <{PREFIX}> . <> <p> <>{',<>' * USES} ."),
    (
        "application/rdf+xml",
        f'<r:RDF xmlns:r="{RDF}" xmlns:x="{PREFIX}"><r:Description>{"<x:p/>" * USES}</r:Description></r:RDF>',
    ),
    ("application/ld+json", json.dumps({"@context": {"@vocab": PREFIX}, "p": [{"@type": "t"}] * USES})),
    (
        "application/ld+json",
        json.dumps({"@context": {"a": PREFIX, "b": {"@id": "a:" + "b" * 20_000}}, "b": [{"@type": "b"}] * 600}),
    ),
    ("application/ld+json", json.dumps({"@context": {"@base": PREFIX}, "http://x/p": [{"@id": ""}] * USES})),
]


@pytest.mark.parametrize(("media_type", "text"), EXPANDING, ids=range(len(EXPANDING)))
@pytest.mark.parametrize("parse", [parse_body, read_ntriples])
def test_prefixes_and_bases_that_expand_too_far_are_refused(
    media_type: str, text: str, parse: Callable[[bytes, str, str], object]
) -> None:
    with pytest.raises(ExpandedBodyError, match="shorten the prefixes"):
        parse(text.encode(), media_type, D)


DENSE = [
    ("text/turtle", f"<> <http://x/p> ({' 1' * 70_000} ) ."),
    ("application/ld+json", json.dumps({"http://x/p": {"@list": [1] * 70_000}})),
    (
        "application/ld+json",
        json.dumps(
            [{"@context": {"x": "http://example.org/vocabulary#"}, "@id": f"#{i}", "x:p": i} for i in range(9_000)]
        ),
    ),
]


@pytest.mark.slow
@pytest.mark.parametrize(("media_type", "text"), DENSE, ids=range(len(DENSE)))
def test_a_dense_body_of_the_usual_prefixes_is_read(media_type: str, text: str) -> None:
    assert parse_body(text.encode(), media_type, D).size >= 9_000
