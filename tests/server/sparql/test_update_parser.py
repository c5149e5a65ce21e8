"""Random updates are accepted or rejected as by pyoxigraph's parser."""

from __future__ import annotations

import re
from itertools import pairwise

import pyoxigraph
from hypothesis import example, given
from hypothesis import strategies as st
from hypothesis.strategies import DrawFn

from rosld.server.http.problem import Problem
from rosld.server.sparql.analysis import Analyser
from rosld.server.sparql.protocol import UpdateRequest
from rosld.server.sparql.syntax.lexer import DEFAULT_BOUNDS, tokens
from rosld.server.sparql.syntax.token import Kind
from rosld.server.sparql.update.operations import ChangeData, Modify, Operation
from rosld.server.sparql.update.parser import read_update

BASE = "http://robot/"
DEFAULT = pyoxigraph.NamedNode("http://robot/data/default")
ANALYSER = Analyser(BASE, "https://w3id.org/rosld/types/", prefixes={})


def read(text: str) -> tuple[Operation, ...]:
    """Return the operations of a text."""
    return read_update(UpdateRequest(text), {}, BASE, DEFAULT_BOUNDS, DEFAULT.value)


def refusal(text: str) -> Problem | None:
    """Return why a text is rejected; None if it is accepted."""
    try:
        read(text)
    except Problem as problem:
        return problem
    return None


VALID = [
    "PREFIX e: <urn:e:> INSERT DATA { e:a e:b 1 , -2.5 , +3e0 ; a e:C ; e:p 'x'@en-GB , \"y\"^^e:t , true , false . "
    "GRAPH <g> { _:x e:p [ e:q ( 1 2 <z> ) ] . } . [] e:p () . }",
    "DELETE DATA { <a> <b> <c> . GRAPH <g> { <a> <b> '''q'u''r''' . <d> <e> .5 } <x> <y> 5. } ;",
    "BASE <http://x/y/> PREFIX : <#> DELETE WHERE { ?s ?p ?o . GRAPH ?g { ?s :p ?o ; :q ?r , ?t } ?a ?b 3 . }",
    "PREFIX e: <urn:e:> WITH <g> DELETE { ?s e:p ?o } INSERT { ?s e:q ?o . GRAPH ?g { [] e:r ?s } } USING <h> USING "
    "NAMED <i> WHERE { ?s e:p ?o . OPTIONAL { ?s e:z ?g FILTER(?o < 3 && ?g != e:x) } BIND(?o + 1 AS ?n) }",
    "INSERT { ?s <p> ?o } WHERE { { SELECT ?s (COUNT(*) AS ?o) WHERE { ?s ?p ?x } GROUP BY ?s } UNION { VALUES (?s ?o) "
    "{ (<a> 1) (UNDEF 'x') } } MINUS { ?s <x>/<y>* ?z } }",
    'DELETE { GRAPH <g> { ?s ?p ?o } } WHERE { GRAPH <g> { ?s ?p ?o # comment { } " \n } FILTER EXISTS { ?s <a> ?b } }',
    "CREATE SILENT GRAPH <a> ; DROP GRAPH <b> ; CLEAR DEFAULT ; CLEAR SILENT NAMED ; DROP ALL ; COPY <a> TO DEFAULT ; "
    "MOVE SILENT GRAPH <a> TO GRAPH <b> ; ADD DEFAULT TO <c> ; LOAD <urn:d> INTO GRAPH <e> ; LOAD SILENT <urn:x>",
    "INSERT DATA { } ; DELETE DATA { GRAPH <x> { } } ; DELETE WHERE { } ; INSERT { } WHERE { } ; DELETE { } INSERT { } "
    "WHERE { }",
    "PREFIX e: <urn:e:> # a comment { \nBASE <http://x/y/> INSERT DATA { GRAPH e:g { e:a e:b 1 , -2.5 , 'x'@en ; a "
    "[ e:p ( <z> true ) ] } }",
    "insert data { GRAPH <g> { <a> <b> 'it' , 1.5 . _:x <c> _:x . } } ;",
    "DELETE DATA { GRAPH <g> { <a> <b> 'it' , 1.5 . <x> <c> <d> } }",
    "INSERT DATA { <a> <b> 'it' . [] <c> () }",
    "PREFIX a: <b>",
    "PREFIX e: <urn:e:> INSERT DATA { e:a\\,b e:%41 e:c.d . e: e:1 e:x-y }",
    'INSERT DATA { <a\\u0041> <b> \'\\u00e9\\n\' , \'a\\\'b\' , """a"b""" }',
    "PREFIX e: <urn:e:> INSERT { ?s e:p ( ?a ?b [ e:q ?c ] ) . ( 1 2 ) e:r _:b . _:b e:z _:b } WHERE { ?s e:p [ e:a "
    "?a ; e:b ?b ] }",
]
TOKENS = (
    ". ; , { } [ ] ( ) a A 1 -1 1. .5 1.5e3 * + / | ^ ! ? @ : é {} [] () @en ^^ ^^<t> 's' 's'@en <x> _:b _:1 _:a.b ?v "
    "$v z:x :x e:.a e:a. << GRAPH DATA WHERE INSERT DELETE SILENT TO INTO DEFAULT ALL NAMED SELECT DISTINCT FILTER "
    "true False @prefix \\u0041 %41 <\\u0020> '"
)
PHRASES = (
    "<a b>,GRAPH <g>,WITH <g>,USING <g>,USING NAMED <g>,FROM <x>,LIMIT 1,VALUES ?v { 1 },PREFIX z: <urn:z>,"
    "BASE <http://b/>,#c\n,\n"
)
PIECES = [*TOKENS.split(), *PHRASES.split(","), '"""']


@st.composite
def mutated(draw: DrawFn) -> str:
    """Return a valid update with a few tokens replaced, moved, removed or repeated."""
    found = [token.text for token in tokens(draw(st.sampled_from(VALID)))]
    for _ in range(draw(st.integers(0, 3))):
        at = draw(st.integers(0, len(found) - 1)) if found else 0
        match draw(st.sampled_from(["drop", "add", "swap", "replace", "repeat"])):
            case "drop":
                del found[at : at + 1]
            case "add":
                found.insert(at, draw(st.sampled_from(PIECES)))
            case "replace":
                found[at : at + 1] = [draw(st.sampled_from(PIECES))]
            case "swap" if found:
                other = draw(st.integers(0, len(found) - 1))
                found[at], found[other] = found[other], found[at]
            case "repeat" if found:
                found.insert(at, found[draw(st.integers(0, len(found) - 1))])
    text = ""
    for piece in found:
        glued = text and piece and re.search(r"[\w:]$", text) and re.match(r"[\w:]", piece)
        text += (" " if glued else "") + piece
    return text


def taken_here(text: str) -> str | None:
    """Return None if an update including its WHEREs is accepted, else why not. No IRI in it is fetched."""
    problem = refusal(text)
    if problem is not None:
        return problem.detail
    for operation in read(text):
        if isinstance(operation, Modify):
            try:
                pyoxigraph.Store().query(ANALYSER.analyse(operation.where.query).text, base_iri=BASE)
            except (SyntaxError, Problem) as error:
                return str(error)
            except (OSError, RuntimeError, ValueError):  # execution is another matter
                pass
    return None


def taken_there(text: str) -> str | None:
    """Return None if pyoxigraph accepts an update, else why not; execution is another matter."""
    try:
        pyoxigraph.Store().update(text, base_iri=BASE)
    except SyntaxError as error:
        return str(error)
    except (OSError, RuntimeError, ValueError):
        pass
    return None


REFUSED_HERE_ONLY = re.compile(
    r"is unexpected; expected (\. or \}|a predicate \(an IRI, a variable or a\))"  # it accepts no dot after a triple
    r"|a literal cannot be a subject"  # the grammar permits it there and RDF does not
    r"|^[+-] at \S+ is unexpected; expected the object of a triple"  # a sign apart from its number
    r"|^; at \S+ is unexpected; expected an operation"  # a semicolon without an operation before it
    r"|triple terms and reifiers|SERVICE"  # the lexer rejects it
    r"| is not valid in SPARQL|not a valid escape|invalid escape|escapes a character| is not closed"  # and this
    r"|joins more than|nests deeper"
)
"""Reasons for intentionally rejecting updates that pyoxigraph accepts."""


def taken_here_only(text: str) -> bool:
    """Whether pyoxigraph rejects valid syntax: a prologue after an operation, booleans in capitals, escapes."""
    found = [token for token in tokens(text) if token.kind not in (Kind.SPACE, Kind.COMMENT)]
    after = any(one.is_mark(";") and two.is_word("PREFIX", "BASE") for one, two in pairwise(found))
    shouted = any(one.is_word("TRUE", "FALSE") and not one.text.islower() for one in found)
    escaped = any(one.kind is Kind.ERROR for one in found)
    return after or shouted or escaped


@given(mutated())
@example("PREFIX a:a: <b>")
@example("INSERT DATA { <a> <b> <c> . . }")
@example("INSERT DATA { GRAPH _:b { <a> <b> <c> } }")
@example("INSERT DATA { GRAPH <g> { <a> <b> <c> # } }")
@example("INSERT DATA { GRAPH <g> { } . . }")
def test_what_is_taken_is_what_the_store_would_take(text: str) -> None:
    here, there = taken_here(text), taken_there(text)
    if there is None and here is not None:
        assert REFUSED_HERE_ONLY.search(here), f"{text!r} is refused here only: {here}"
    elif here is None and there is not None:
        assert taken_here_only(text), f"{text!r} is taken here only: {there}"


@given(mutated())
def test_data_are_those_that_the_store_would_insert(text: str) -> None:
    if taken_here(text) is not None or taken_there(text) is not None:
        return
    operations = read(text)
    if any(not isinstance(each, ChangeData) for each in operations):
        return
    ours, theirs = pyoxigraph.Store(), pyoxigraph.Store()
    for operation in operations:
        for quad in operation.deletes:
            ours.remove(quad)
        ours.extend(operation.inserts)
    theirs.update(text, base_iri=BASE)
    in_default = [*theirs.quads_for_pattern(None, None, None, pyoxigraph.DefaultGraph())]
    theirs.clear_graph(pyoxigraph.DefaultGraph())
    theirs.extend(pyoxigraph.Quad(each.subject, each.predicate, each.object, DEFAULT) for each in in_default)
    assert _canonical(ours) == _canonical(theirs)


def _canonical(store: pyoxigraph.Store) -> pyoxigraph.Dataset:
    dataset = pyoxigraph.Dataset(store)
    dataset.canonicalize(pyoxigraph.CanonicalizationAlgorithm.UNSTABLE)
    return dataset


@given(st.text(max_size=200) | st.lists(st.sampled_from(PIECES), max_size=30).map(" ".join))
def test_no_text_is_worse_than_refused(text: str) -> None:
    problem = refusal(text)
    assert problem is None or problem.status == 400


def test_what_could_be_cut_in_two_ways_is_not_taken_in_either() -> None:
    text = "INSERT { <a> <b> <c> } WHERE { ?a ?b ?c FILTER(?a<'&&?c>') } LIMIT 1 # ' }"
    assert taken_here(text) is not None
    assert taken_there(text) is not None
