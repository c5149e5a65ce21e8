"""Texts of updates over HTTP: invalid ones are refused with the position, without any effect."""

from __future__ import annotations

import httpx

UPDATE = {"Content-Type": "application/sparql-update"}
WRONG = [
    ("INSERT", "The update ends where"),
    ("INSERT DATA { <a> <b> <c> ", "The update ends where"),
    ("INSERT { } ", "The update ends where"),
    ("; INSERT DATA { }", "; at 1:1"),
    ("INSERT DATA { } INSERT DATA { }", "INSERT at 1:17"),
    ("INSERT DATA { } }", "} at 1:17"),
    ("INSERT DATA { } ; ; INSERT DATA { }", "; at 1:19"),
    ("SELECT * WHERE { ?s ?p ?o }", "SELECT at 1:1"),
    ("FOO BAR", "FOO at 1:1"),
    ("PREFIX e <urn:e:>", "e at 1:8"),
    ("PREFIX a:a: <b>", "a:a: at 1:8"),
    ("PREFIX e: e:x", "e:x at 1:11"),
    ("BASE x:y", "x:y at 1:6"),
    ("CLEAR", "The update ends where"),
    ("CLEAR <g>", "<g> at 1:7"),
    ("CREATE <g>", "<g> at 1:8"),
    ("CREATE DEFAULT", "DEFAULT at 1:8"),
    ("COPY <a> <b>", "<b> at 1:10"),
    ("COPY ALL TO <b>", "ALL at 1:6"),
    ("MOVE <a> TO NAMED", "NAMED at 1:13"),
    ("LOAD <a> INTO <g>", "<g> at 1:15"),
    ("WITH <g> INSERT DATA { }", "DATA at 1:17"),
    ("WITH <g> DELETE WHERE { }", "WHERE at 1:17"),
    ("WITH ?g DELETE { } WHERE { }", "?g at 1:6"),
    ("INSERT { } DELETE { } WHERE { }", "DELETE at 1:12"),
    ("INSERT { } USING ?g WHERE { }", "?g at 1:18"),
    ("INSERT { } WHERE ?s", "?s at 1:18"),
    ("INSERT DATA { ?s <b> <c> }", "INSERT DATA at 1:13 cannot contain variables such as ?s"),
    ("DELETE DATA { <a> <b> ?o }", "DELETE DATA at 1:13 cannot contain variables such as ?o"),
    ("DELETE DATA { _:x <b> <c> }", "DELETE at 1:13 cannot contain a blank node"),
    ("DELETE DATA { <a> <b> [] }", "DELETE at 1:13 cannot contain a blank node"),
    ("DELETE { <a> <b> ( 1 ) } WHERE { }", "DELETE at 1:8 cannot contain a blank node"),
    ("DELETE WHERE { _:x <b> ?o }", "DELETE at 1:14 cannot contain a blank node"),
    ("INSERT DATA {\n <a> <b> .\n}", "2:10"),
    ("INSERT DATA {\n <a> <b> <c>\n <d> <e> <f> }", "3:2"),
    ("INSERT DATA { <a> 'x' <c> }", "1:19"),
    ("INSERT DATA { 'x' <b> <c> }", "1:15"),
    ("INSERT DATA { 1 <b> <c> }", "1:15"),
    ("INSERT DATA { <a> _:b <c> }", "1:19"),
    ("INSERT DATA { <a> <b> a }", "1:23"),
    ("INSERT DATA { <a> A <c> }", "A at 1:19"),
    ("INSERT DATA { <a> <b> - 1 }", "1:23"),
    ("INSERT DATA { <a> <b> <c> . . }", ". at 1:29"),
    ("INSERT DATA { . }", ". at 1:15"),
    ("INSERT DATA { GRAPH <g> { } . . }", ". at 1:31"),
    ("INSERT DATA { { <a> <b> <c> } }", "{ at 1:15"),
    ("INSERT DATA { <g> { <a> <b> <c> } }", "{ at 1:19"),
    ("INSERT DATA { GRAPH { <a> <b> <c> } }", "{ at 1:21"),
    ("INSERT DATA { GRAPH _:g { <a> <b> <c> } }", "_:g at 1:21"),
    ("INSERT DATA { GRAPH 'g' { <a> <b> <c> } }", "'g' at 1:21"),
    ("INSERT DATA { GRAPH <g> <a> <b> <c> }", "<a> at 1:25"),
    ("INSERT DATA { GRAPH <g> { GRAPH <h> { <a> <b> <c> } } }", "GRAPH at 1:27"),
    ("INSERT DATA { GRAPH <g> }", "1:25"),
    ("INSERT DATA { <a> <b> ( GRAPH <g> { } ) }", "GRAPH at 1:25"),
    ("INSERT DATA { <a> <b>/<c> <d> }", "1:22"),
    ("INSERT DATA { <a> ^<b> <d> }", "1:19"),
    ("INSERT DATA { <a> <b> <c> FILTER(true) }", "FILTER at 1:27"),
    ("INSERT DATA { @prefix ros: <urn:e:> . ros:a ros:b ros:c }", "@prefix at 1:15"),
    ("INSERT DATA { PREFIX e: <urn:e:> e:a e:b e:c }", "PREFIX at 1:15"),
    ("INSERT DATA { BASE <x> <a> <b> <c> }", "BASE at 1:15"),
    ("INSERT DATA { <a> <b> 'x'^^?t }", "1:28"),
    ("INSERT DATA { <a> <b> 'x'@e_n }", "1:28"),
    ("INSERT DATA { nope:a <b> <c> }", "The prefix nope: is not declared, at 1:15"),
    ("INSERT { nope:a <b> <c> } WHERE { }", "The prefix nope: is not declared, at 1:10"),
    ("INSERT DATA { <a> <b> 'x }", "string that begins at 1:23 is not closed"),
    ("INSERT DATA { <a> <b> <c d> }", "< at 1:23 does not begin an IRI"),
    ("INSERT DATA { <http://[/> <b> <c> }", "1:15"),
    ("INSERT DATA { << <a> <b> <c> >> <b> <c> }", "<< at 1:15"),
    ("INSERT { } WHERE { SERVICE <s> { } }", "SERVICE at 1:20"),
    ("INSERT DATA { \\u003ca> <b> <c> }", "1:15"),
]
RIGHT = [
    "",
    "# no operation",
    "insert data { graph <data/x> { <a> <b> TRUE , False , 1. <c> a <d> ; ; } } ;",
    "PREFIX e: <urn:e:> BASE <data/> INSERT DATA { GRAPH <y> { e:a\\,b e:%41 e:c.d . e: e:1 e:x-y } } ; "
    "BASE <z/> PREFIX e: <urn:f:> INSERT DATA { GRAPH <g> { e:a a ros:Topic } }",
    "INSERT DATA { GRAPH <data/x> { <a\\u0041> <b> '\\u00e9 } #' , '''{ \"''' . [ <p> ( ) ] <q> _:b } }",
    "INSERT { GRAPH <data/x> { ?_v ?0 $w } } WHERE { VALUES (?_v ?0 ?w) { } }",
    "DELETE { } INSERT { } WHERE { }",
]


def send(http: httpx.Client, text: str) -> httpx.Response:
    return http.post("/sparql", content=text.encode(), headers=UPDATE, params={"dry-run": "true"})


def test_a_wrong_text_is_refused_where_it_is_wrong(http: httpx.Client) -> None:
    wrong = []
    for text, words in WRONG:
        answer = send(http, text)
        if answer.status_code != 400 or words not in answer.json()["detail"]:
            wrong.append((text, words, answer.text))
    assert not wrong, wrong


def test_every_form_of_the_grammar_is_taken(http: httpx.Client) -> None:
    wrong = [(text, answer.text) for text in RIGHT if (answer := send(http, text)).status_code != 200]
    assert not wrong, wrong


def test_nesting_and_length_are_bounded(http: httpx.Client) -> None:
    deep = f"INSERT DATA {{ <a> <b> {'( ' * 200}{' )' * 200} }}"
    assert "nests deeper than 128" in send(http, deep).json()["detail"]
    many = ";".join(["INSERT DATA { }"] * 2000)
    assert "the limit is 1000" in send(http, many).json()["detail"]
