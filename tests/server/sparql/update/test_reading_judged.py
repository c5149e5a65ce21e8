"""Updates made up at random: read as they were meant, and taken or refused as the store's own parser has it."""

from __future__ import annotations

import re
from collections import Counter
from itertools import pairwise

import pyoxigraph
from hypothesis import example, given, settings
from hypothesis import strategies as st
from hypothesis.strategies import DrawFn, SearchStrategy
from pyoxigraph import Literal, NamedNode

from rosld.server.http.problem import Problem
from rosld.server.sparql.analysis import Analyser
from rosld.server.sparql.protocol import UpdateRequest
from rosld.server.sparql.syntax.lexer import DEFAULT_BOUNDS, tokens
from rosld.server.sparql.syntax.token import Kind
from rosld.server.sparql.update.operations import (
    GraphGroup,
    GraphVerb,
    ManageGraph,
    Modify,
    Operation,
    QuadTemplate,
    TemplateTerm,
    TemplateVariable,
)
from rosld.server.sparql.update.parser import read_update

BASE = "http://robot/"
EXAMPLE = "urn:e:"
XSD = "http://www.w3.org/2001/XMLSchema#"
ANALYSER = Analyser(BASE, "https://w3id.org/rosld/types/", prefixes={})
RDF_TYPE = NamedNode("http://www.w3.org/1999/02/22-rdf-syntax-ns#type")


def read(text: str) -> tuple[Operation, ...]:
    """The operations of a text."""
    return read_update(UpdateRequest(text), {}, BASE, DEFAULT_BOUNDS)


def refusal(text: str) -> Problem | None:
    """Why a text is refused; None where it is read."""
    try:
        read(text)
    except Problem as problem:
        return problem
    return None


# As they were meant: each is a value, and one of the texts that mean it

GAPS = st.sampled_from([" ", "\n", "\t ", " # } ' \" { ;\n", "\r\n"])
NAMES = st.text("abxyz019", min_size=1, max_size=3)
WORDS = st.text(st.characters(codec="utf-8", exclude_characters="\x00"), max_size=6)


@st.composite
def cased(draw: DrawFn, word: str) -> str:
    """A keyword in some case."""
    return draw(st.sampled_from([word, word.lower(), word.capitalize()]))


@st.composite
def iris(draw: DrawFn) -> tuple[NamedNode, str]:
    """An IRI: whole, below the base, by a prefix, or with an escape."""
    name = draw(NAMES)
    return draw(
        st.sampled_from(
            [
                (NamedNode(f"{BASE}{name}"), f"<{name}>"),
                (NamedNode(f"{BASE}{name}"), f"<{BASE}{name}>"),
                (NamedNode(f"{BASE}{name}A"), f"<{name}\\u0041>"),
                (NamedNode(f"{BASE}{name}#x"), f"<{name}#x>"),
                (NamedNode(f"{EXAMPLE}{name}"), f"e:{name}"),
                (NamedNode(f"{EXAMPLE}{name}"), f"<{EXAMPLE}{name}>"),
                (NamedNode(f"{EXAMPLE}{name}.{name}-"), f"e:{name}.{name}-"),
                (NamedNode(f"{EXAMPLE}{name}"), f":{name}"),
            ]
        )
    )


def _quoted(words: str, quote: str) -> str:
    escaped = words.replace("\\", "\\\\").replace(quote[0], f"\\{quote[0]}")
    return quote + escaped.replace("\n", "\\n").replace("\r", "\\r") + quote


@st.composite
def literals(draw: DrawFn) -> tuple[Literal, str]:
    """A literal in some spelling."""
    words = draw(WORDS)
    text = _quoted(words, draw(st.sampled_from(['"', "'", '"""', "'''"])))
    sign, number = draw(st.sampled_from(["", "-", "+"])), draw(st.integers(0, 99))
    return draw(
        st.sampled_from(
            [
                (Literal(words), text),
                (Literal(words, language="en-gb"), f"{text}@en-GB"),
                (Literal(words, datatype=NamedNode(f"{EXAMPLE}t")), f"{text}^^e:t"),
                (Literal(words, datatype=NamedNode(f"{BASE}t")), f"{text} ^^ <t>"),
                (Literal(f"{sign}{number}", datatype=NamedNode(f"{XSD}integer")), f"{sign}{number}"),
                (Literal(f"-{number}.5", datatype=NamedNode(f"{XSD}decimal")), f"-{number}.5"),
                (Literal(f".{number}E-1", datatype=NamedNode(f"{XSD}double")), f".{number}E-1"),
                (Literal("true", datatype=NamedNode(f"{XSD}boolean")), "True"),
            ]
        )
    )


def holes() -> SearchStrategy[tuple[TemplateVariable, str]]:
    """A variable with either mark."""
    return st.builds(lambda name, mark: (TemplateVariable(name), f"{mark}{name}"), NAMES, st.sampled_from("?$"))


@st.composite
def blocks(draw: DrawFn, variables: bool) -> tuple[list[QuadTemplate], str]:
    """Quads between braces: what they are, and a text for them."""
    held = holes() if variables else st.nothing()
    nodes: SearchStrategy[tuple[TemplateTerm, str]] = iris() | held
    graphs: SearchStrategy[tuple[TemplateTerm, str] | None] = st.none() | iris() | held
    dispatcher = nodes | st.just((RDF_TYPE, "a"))
    quads: list[QuadTemplate] = []
    text = ""
    for graph in draw(st.lists(graphs, max_size=3)):
        gap = draw(GAPS)
        triples, told = draw(_triples(nodes, dispatcher))
        if graph is None:
            text += ("" if not text or text.rstrip().endswith(("}", ".")) else " .") + gap + told
        else:
            text += f"{gap}{draw(cased('GRAPH'))} {graph[1]}{gap}{{{told}}}" + draw(st.sampled_from(["", " ."]))
        name = None if graph is None else graph[0]
        assert name is None or isinstance(name, NamedNode | TemplateVariable)
        quads += [QuadTemplate(*each, name) for each in triples]
    return quads, f"{{{text}{draw(GAPS)}}}"


@st.composite
def _triples(
    draw: DrawFn, nodes: SearchStrategy[tuple[TemplateTerm, str]], dispatcher: SearchStrategy[tuple[TemplateTerm, str]]
) -> tuple[list[tuple[TemplateTerm, TemplateTerm, TemplateTerm]], str]:
    """Triples, subjects and predicates said once for what they share."""
    found: list[tuple[TemplateTerm, TemplateTerm, TemplateTerm]] = []
    text = ""
    for subject, subject_text in draw(st.lists(nodes, min_size=1, max_size=2)):
        text += (" . " if text else "") + subject_text
        for at, (verb, verb_text) in enumerate(draw(st.lists(dispatcher, min_size=1, max_size=2))):
            things = draw(st.lists(nodes | literals(), min_size=1, max_size=2))
            found += [(subject, verb, thing) for thing, _ in things]
            gap = draw(GAPS)
            text += (" ; " if at else " ") + verb_text + gap + f"{gap}, ".join(told for _, told in things)
        text += draw(st.sampled_from(["", " ;"]))
    return found, text + draw(st.sampled_from(["", " .", "\n."]))


@st.composite
def modifications(draw: DrawFn) -> tuple[Modify, str]:
    """INSERT, DELETE or both, with data or with a WHERE."""
    if draw(st.booleans()):
        quads, text = draw(blocks(variables=False))
        verb = draw(st.sampled_from(["INSERT", "DELETE"]))
        meant = Modify(inserts=tuple(quads)) if verb == "INSERT" else Modify(deletes=tuple(quads))
        return meant, f"{draw(cased(verb))}{draw(GAPS)}{draw(cased('DATA'))}{draw(GAPS)}{text}"
    home = draw(st.none() | iris())
    deletes, inserts = draw(st.none() | blocks(variables=True)), draw(st.none() | blocks(variables=True))
    if deletes is None and inserts is None:
        deletes = ([], "{ }")
    parts = ["WITH " + home[1]] if home is not None else []
    parts += [f"{draw(cased('DELETE'))}{draw(GAPS)}{deletes[1]}"] if deletes is not None else []
    parts += [f"{draw(cased('INSERT'))}{draw(GAPS)}{inserts[1]}"] if inserts is not None else []
    parts += [draw(cased("WHERE")), "{ ?x ?y '} WHERE {' }"]
    graph = None if home is None else home[0]

    def within(quads: list[QuadTemplate]) -> tuple[QuadTemplate, ...]:
        return tuple(each if each.graph is not None else each._replace(graph=graph) for each in quads)

    return Modify(within(deletes[0] if deletes else []), within(inserts[0] if inserts else [])), draw(GAPS).join(parts)


@st.composite
def managements(draw: DrawFn) -> tuple[ManageGraph, str]:
    """An operation on whole graphs."""
    verb, silent = draw(st.sampled_from(list(GraphVerb))), draw(st.booleans())
    (target, text), (source, source_text) = draw(iris()), draw(iris())
    head = draw(cased(verb.value)) + draw(GAPS) + (draw(cased("SILENT")) + draw(GAPS) if silent else "")
    if verb in (GraphVerb.ADD, GraphVerb.MOVE, GraphVerb.COPY):
        told = f"{head}{draw(st.sampled_from(['', 'GRAPH ']))}{source_text} {draw(cased('TO'))} {text}"
        return ManageGraph(verb, target.value, source.value, silent), told
    if verb is not GraphVerb.CREATE and draw(st.booleans()):
        several = draw(st.sampled_from(list(GraphGroup)))
        return ManageGraph(verb, several, None, silent), head + draw(cased(several.value))
    return ManageGraph(verb, target.value, None, silent), f"{head}{draw(cased('GRAPH'))} {text}"


def known(operation: Operation) -> object:
    """What is compared of an operation: its quads in any order, its WHERE apart."""
    if isinstance(operation, Modify):
        return Counter(map(repr, operation.deletes)), Counter(map(repr, operation.inserts))
    return operation


@given(st.lists(modifications() | managements(), max_size=3), GAPS, st.booleans())
@settings(max_examples=150, deadline=None)
def test_what_is_written_is_read_as_it_was_meant(meant: list[tuple[Operation, str]], gap: str, ended: bool) -> None:
    text = f"PREFIX e: <{EXAMPLE}>{gap}PREFIX : <{EXAMPLE}>{gap}" + f"{gap};{gap}".join(told for _, told in meant)
    found = read(text + (";" if ended and meant else ""))
    assert [known(each) for each in found] == [known(operation) for operation, _ in meant]
    for each in found:
        if isinstance(each, Modify) and each.where is not None:
            pyoxigraph.Store().query(each.where.query, base_iri=BASE)  # the store can read it


# As the store's own parser has it

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
    """A valid update of which a few tokens are others, elsewhere, gone or twice there."""
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
    """None where an update is taken, WHEREs included, else why it is not. No IRI of the texts is reached out to."""
    problem = refusal(text)
    if problem is not None:
        return problem.detail
    for operation in read(text):
        if isinstance(operation, Modify) and operation.where is not None:
            try:
                pyoxigraph.Store().query(ANALYSER.analyse(operation.where.query).text, base_iri=BASE)
            except (SyntaxError, Problem) as error:
                return str(error)
            except (OSError, RuntimeError, ValueError):  # whether it can be carried out is another matter
                pass
    return None


def taken_there(text: str) -> str | None:
    """None where pyoxigraph takes an update, else why it does not; whether it can be carried out is another matter."""
    try:
        pyoxigraph.Store().update(text, base_iri=BASE)
    except SyntaxError as error:
        return str(error)
    except (OSError, RuntimeError, ValueError):
        pass
    return None


REFUSED_HERE_ONLY = re.compile(
    r"stands where (\. or \}|a predicate \(an IRI, a variable or a\)) is expected"  # it wants no dot after a triple
    r"|a literal is no subject"  # which the grammar lets stand there and RDF does not
    r"|^[+-] at \S+ stands where the object of a triple"  # a sign apart from its number
    r"|^; at \S+ stands where an operation"  # a semicolon without an operation before it
    r"|triple terms and reifiers|SERVICE"  # what is refused by the lexer
    r"| is no part of SPARQL|escapes nothing|an escape of a character| has no end"  # and this
    r"|joins more than|nests deeper"
)
"""Why what pyoxigraph takes is refused on purpose."""


def taken_here_only(text: str) -> bool:
    """Whether pyoxigraph refuses what the grammar has: a prologue after an operation, booleans in capitals, escapes."""
    found = [token for token in tokens(text) if token.kind not in (Kind.SPACE, Kind.COMMENT)]
    after = any(one.is_mark(";") and two.is_word("PREFIX", "BASE") for one, two in pairwise(found))
    shouted = any(one.is_word("TRUE", "FALSE") and not one.text.islower() for one in found)
    escaped = any(one.kind is Kind.ERROR for one in found)
    return after or shouted or escaped


@given(mutated())
@settings(max_examples=600, deadline=None)
@example("PREFIX a:a: <b>")
@example("INSERT DATA { <a> <b> <c> . . }")
@example("INSERT DATA { GRAPH <g> { } . . }")
def test_what_is_taken_is_what_the_store_would_take(text: str) -> None:
    here, there = taken_here(text), taken_there(text)
    if there is None and here is not None:
        assert REFUSED_HERE_ONLY.search(here), f"{text!r} is refused here only: {here}"
    elif here is None and there is not None:
        assert taken_here_only(text), f"{text!r} is taken here only: {there}"


@given(st.text(max_size=200) | st.lists(st.sampled_from(PIECES), max_size=30).map(" ".join))
@settings(max_examples=250, deadline=None)
def test_no_text_is_worse_than_refused(text: str) -> None:
    problem = refusal(text)
    assert problem is None or problem.status == 400


def test_what_could_be_cut_in_two_ways_is_not_taken_in_either() -> None:
    text = "INSERT { <a> <b> <c> } WHERE { ?a ?b ?c FILTER(?a<'&&?c>') } LIMIT 1 # ' }"
    assert taken_here(text) is not None
    assert taken_there(text) is not None
