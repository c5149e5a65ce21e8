"""Reading updates: each operation of SPARQL 1.1 Update as a value, and each wrong text refused where it is wrong."""

from __future__ import annotations

import pytest
from pyoxigraph import BlankNode, Literal, NamedNode

from rosld.server.http.problem import Problem
from rosld.server.sparql.protocol import UpdateRequest
from rosld.server.sparql.syntax.lexer import DEFAULT_BOUNDS, QueryBounds
from rosld.server.sparql.update.operations import (
    GraphGroup,
    GraphVerb,
    Load,
    ManageGraph,
    Modify,
    Operation,
    QuadTemplate,
    TemplateVariable,
    Where,
    WithGraph,
)
from rosld.server.sparql.update.parser import read_update

BASE = "http://robot/"
XSD = "http://www.w3.org/2001/XMLSchema#"
RDF = "http://www.w3.org/1999/02/22-rdf-syntax-ns#"
PREFIXES = {"ros": "https://w3id.org/rosld#"}


def read(text: str, *using: str, bounds: QueryBounds = DEFAULT_BOUNDS) -> tuple[Operation, ...]:
    """The operations of a text, in a request that names these graphs."""
    return read_update(UpdateRequest(text, using), PREFIXES, BASE, bounds)


def only(text: str) -> Modify:
    """The one operation of a text, which changes quads."""
    [operation] = read(text)
    assert isinstance(operation, Modify)
    return operation


def inserted(block: str) -> tuple[QuadTemplate, ...]:
    """The quads of a block, with the prefix `e:`."""
    return only(f"PREFIX e: <urn:e:> INSERT DATA {{ {block} }}").inserts


def objects(block: str) -> list[object]:
    """What stands as the object of the quads of a block."""
    return [quad.object for quad in inserted(block)]


def node(name: str) -> NamedNode:
    """An IRI by what it has beyond the base."""
    return NamedNode(BASE + name)


def named(name: str) -> NamedNode:
    """An IRI of the prefix `e:`."""
    return NamedNode(f"urn:e:{name}")


def group(where: Where | None) -> str:
    """The query of a WHERE, with one blank wherever there are some."""
    assert where is not None
    return " ".join(where.query.split())


def refusal(text: str, *, bounds: QueryBounds = DEFAULT_BOUNDS) -> str:
    """Why a text is refused."""
    with pytest.raises(Problem) as caught:
        read(text, bounds=bounds)
    assert caught.value.status == 400
    return caught.value.detail


A, B, C, G = node("a"), node("b"), node("c"), node("g")
ABC = "<a> <b> <c>"


# The operations


def test_an_update_may_have_no_operation() -> None:
    for text in ("", "  # nothing\n", "PREFIX e: <urn:e:>", "BASE <http://elsewhere/> PREFIX : <x>"):
        assert read(text) == ()


def test_insert_data_and_delete_data_are_quads_without_a_where() -> None:
    assert only(f"INSERT DATA {{ {ABC} }}") == Modify(inserts=(QuadTemplate(A, B, C, None),))
    assert only(f"DELETE DATA {{ GRAPH <g> {{ {ABC} }} }}") == Modify(deletes=(QuadTemplate(A, B, C, G),))


def test_the_pattern_of_delete_where_is_what_is_deleted() -> None:
    operation = only("DELETE WHERE { ?s <b> ?o . GRAPH ?g { ?s <b> <c> } }")
    assert operation.deletes == (
        QuadTemplate(TemplateVariable("s"), B, TemplateVariable("o"), None),
        QuadTemplate(TemplateVariable("s"), B, C, TemplateVariable("g")),
    )
    assert operation.inserts == ()
    assert operation.where is not None
    assert operation.where.variables == ("s", "o", "g")
    assert group(operation.where) == "SELECT ?s ?o ?g WHERE { ?s <b> ?o . GRAPH ?g { ?s <b> <c> } }"


def test_delete_and_insert_share_a_where() -> None:
    operation = only(
        "DELETE { <a> <b> ?o } INSERT { GRAPH <g> { <a> <b> ?n } } WHERE { <a> <b> ?o BIND(?o + 1 AS ?n) }"
    )
    assert operation.deletes == (QuadTemplate(A, B, TemplateVariable("o"), None),)
    assert operation.inserts == (QuadTemplate(A, B, TemplateVariable("n"), G),)
    assert operation.where is not None
    assert operation.where.variables == ("o", "n")


def test_insert_may_stand_alone_and_templates_without_variables_ask_whether_the_where_holds() -> None:
    operation = only(f"INSERT {{ {ABC} }} WHERE {{ ?s ?p 5 }}")
    assert operation.deletes == ()
    assert operation.where == Where(operation.where.query if operation.where else "", ())
    assert group(operation.where) == "ASK { ?s ?p 5 }"


def test_with_is_the_graph_of_what_names_none() -> None:
    operation = only("WITH <g> DELETE { ?s <b> ?o } INSERT { ?s <c> ?o . GRAPH <a> { ?s <c> ?o } } WHERE { ?s <b> ?o }")
    assert [quad.graph for quad in operation.deletes] == [G]
    assert [quad.graph for quad in operation.inserts] == [G, A]
    assert group(operation.where) == f"SELECT ?s ?o WHERE {{GRAPH <{BASE}g> {{ ?s <b> ?o }}}}"
    assert operation.where is not None
    assert operation.where.with_graph == WithGraph(f"{BASE}g", "SELECT ?s ?o WHERE { ?s <b> ?o }")


def test_using_is_the_dataset_of_the_where_whatever_with_says() -> None:
    operation = only("WITH <g> DELETE { ?s <b> 1 } USING <a> USING <b> USING NAMED <c> WHERE { ?s <b> 1 }")
    assert operation.deletes[0].graph == G
    assert operation.where is not None
    assert (operation.where.default_graphs, operation.where.named_graphs) == ((f"{BASE}a", f"{BASE}b"), (f"{BASE}c",))
    assert operation.where.with_graph is None
    assert "GRAPH" not in operation.where.query


def test_using_may_stand_in_the_request() -> None:
    [operation] = read("INSERT { ?s <b> 1 } WHERE { ?s <b> 2 }", "http://other/g")
    assert isinstance(operation, Modify)
    assert operation.where is not None
    assert operation.where.default_graphs == ("http://other/g",)


@pytest.mark.parametrize(
    ("text", "operation"),
    [
        ("CLEAR GRAPH <g>", ManageGraph(GraphVerb.CLEAR, f"{BASE}g")),
        ("clear silent graph ros:g", ManageGraph(GraphVerb.CLEAR, "https://w3id.org/rosld#g", None, True)),
        ("CLEAR DEFAULT", ManageGraph(GraphVerb.CLEAR, GraphGroup.DEFAULT)),
        ("Drop Silent Named", ManageGraph(GraphVerb.DROP, GraphGroup.NAMED, None, True)),
        ("DROP ALL", ManageGraph(GraphVerb.DROP, GraphGroup.ALL)),
        ("CREATE GRAPH <g>", ManageGraph(GraphVerb.CREATE, f"{BASE}g")),
        ("CREATE SILENT GRAPH <g>", ManageGraph(GraphVerb.CREATE, f"{BASE}g", None, True)),
        ("COPY <g> TO DEFAULT", ManageGraph(GraphVerb.COPY, GraphGroup.DEFAULT, f"{BASE}g")),
        ("MOVE SILENT DEFAULT TO GRAPH <g>", ManageGraph(GraphVerb.MOVE, f"{BASE}g", GraphGroup.DEFAULT, True)),
        ("ADD GRAPH <a> TO <g>", ManageGraph(GraphVerb.ADD, f"{BASE}g", f"{BASE}a")),
        ("LOAD <a>", Load(f"{BASE}a", None)),
        ("LOAD SILENT <a> INTO GRAPH <g>", Load(f"{BASE}a", f"{BASE}g", True)),
    ],
)
def test_operations_on_whole_graphs(text: str, operation: Operation) -> None:
    assert read(text) == (operation,)


def test_keywords_may_be_written_in_any_case() -> None:
    text = f"with <g> delete {{ {ABC} }} Insert {{ {ABC} }} using named <a> wHERE {{ ?s a ?o }}"
    operation = only(text)
    assert (operation.deletes, operation.where and operation.where.named_graphs) == (
        (QuadTemplate(A, B, C, G),),
        (f"{BASE}a",),
    )


def test_operations_follow_each_other_and_a_semicolon_may_end_them() -> None:
    one = f"INSERT DATA {{ {ABC} }}"
    assert len(read(f"{one};{one}")) == 2
    assert len(read(f"{one} ; {one} ;")) == 2
    assert len(read(f"{one} ; PREFIX e: <urn:e:> ")) == 1


def test_blocks_may_be_empty() -> None:
    for text in ("INSERT DATA {}", "DELETE DATA { GRAPH <g> { } }", "DELETE { } INSERT { } WHERE { ?s ?p ?o }"):
        operation = only(text)
        assert (operation.deletes, operation.inserts) == ((), ())
    assert only("DELETE WHERE { }").deletes == ()


# Names


def test_a_prologue_may_stand_before_each_operation_and_holds_on() -> None:
    first, second, third = read(
        "PREFIX e: <urn:one:> INSERT DATA { e:a e:b e:c } ; "
        "PREFIX e: <urn:two:> PREFIX f: <urn:f:> INSERT DATA { e:a f:b e:c } ; INSERT DATA { e:a f:b e:c }"
    )
    assert isinstance(first, Modify)
    assert isinstance(second, Modify)
    assert first.inserts[0].subject == NamedNode("urn:one:a")
    assert second.inserts[0] == (NamedNode("urn:two:a"), NamedNode("urn:f:b"), NamedNode("urn:two:c"), None)
    assert third == second


def test_the_base_changes_where_another_is_declared_and_may_itself_be_relative() -> None:
    first, second, third = read(
        f"INSERT DATA {{ {ABC} }} ; BASE <http://other/x/> INSERT DATA {{ {ABC} }} ; BASE <../y/> CLEAR GRAPH <g>"
    )
    assert isinstance(first, Modify)
    assert isinstance(second, Modify)
    assert (first.inserts[0].subject, second.inserts[0].subject) == (A, NamedNode("http://other/x/a"))
    assert third == ManageGraph(GraphVerb.CLEAR, "http://other/y/g")


def test_a_where_has_the_prologue_that_holds_where_it_stands() -> None:
    first, second = read(
        "PREFIX e: <urn:one:> INSERT { ?s e:b 1 } WHERE { ?s e:b 2 } ; "
        "PREFIX e: <urn:two:> BASE <http://b/> INSERT { ?s e:b 1 } WHERE { ?s e:b <x> }"
    )
    assert isinstance(first, Modify)
    assert isinstance(second, Modify)
    assert group(first.where).startswith("PREFIX e: <urn:one:> SELECT")
    assert group(second.where).startswith("PREFIX e: <urn:one:> PREFIX e: <urn:two:> BASE <http://b/> SELECT")


def test_the_prefixes_of_the_server_need_no_declaration() -> None:
    assert only("INSERT DATA { <a> ros:value 1 }").inserts[0].predicate == NamedNode("https://w3id.org/rosld#value")


def test_prefixed_names_have_all_the_forms_of_the_grammar() -> None:
    assert [
        quad.predicate for quad in inserted("<a> e: 1 ; e:b.c 2 ; e:1 3 ; e:x-y 4 ; e:%41 5 ; e:a\\,b 6 ; e:b:c 7")
    ] == [named(name) for name in ("", "b.c", "1", "x-y", "%41", "a,b", "b:c")]
    assert only("PREFIX : <urn:e:> INSERT DATA { :a : :b. }").inserts == (
        QuadTemplate(named("a"), named(""), named("b"), None),
    )


# Terms and triples


def test_literals_have_all_the_forms_of_the_grammar() -> None:
    assert objects('<a> <b> 1 , -2.5 , +3e0 , .5 , \'x\' , "y" , \'\'\'q\'u"r\'\'\' , """a\n"b"""') == [
        Literal("1", datatype=NamedNode(f"{XSD}integer")),
        Literal("-2.5", datatype=NamedNode(f"{XSD}decimal")),
        Literal("+3e0", datatype=NamedNode(f"{XSD}double")),
        Literal(".5", datatype=NamedNode(f"{XSD}decimal")),
        Literal("x"),
        Literal("y"),
        Literal("q'u\"r"),
        Literal('a\n"b'),
    ]
    assert objects("<a> <b> 'x'@en-GB , 'y'^^e:t , 'z'^^<t>") == [
        Literal("x", language="en-gb"),
        Literal("y", datatype=named("t")),
        Literal("z", datatype=node("t")),
    ]


def test_a_number_before_a_full_stop_is_whole() -> None:
    assert objects("<a> <b> 1. <a> <b> 2 .") == [Literal(each, datatype=NamedNode(f"{XSD}integer")) for each in "12"]


@pytest.mark.parametrize("word", ["true", "TRUE", "True", "false", "FALSE"])
def test_booleans_may_be_written_in_any_case(word: str) -> None:
    assert objects(f"<a> <b> {word}") == [Literal(word.lower(), datatype=NamedNode(f"{XSD}boolean"))]


def test_escapes_stand_for_their_characters() -> None:
    [quad] = inserted("<a\\u0041> <b> '\\u00e9\\U0001F600\\n\\t\\''")
    assert (quad.subject, quad.object) == (node("aA"), Literal("é😀\n\t'"))


def test_what_holds_braces_quotes_and_hashes_is_cut_nowhere() -> None:
    operation = only(
        "# } ; DROP ALL '\nINSERT { <a#b> <b> '} ; { # \"' , \"it's\" , '''}\n}''' } # }\n"
        "WHERE { ?s <b> '}' # } ' \"\n FILTER(?s != <c#}> || ?s = '#') }".replace("<c#}>", "<c#d>")
    )
    assert [quad.object for quad in operation.inserts] == [Literal('} ; { # "'), Literal("it's"), Literal("}\n}")]
    assert group(operation.where) == "ASK { ?s <b> '}' FILTER(?s != <c#d> || ?s = '#') }"


def test_lists_property_lists_and_labels_are_blank_nodes() -> None:
    quads = inserted("_:x e:p ( 1 [ e:q _:x ] ) . [] e:p () . [ e:r _:y ] .")
    predicates = [quad.predicate.value if isinstance(quad.predicate, NamedNode) else "" for quad in quads]
    assert sorted(predicates) == sorted(
        [f"{RDF}first", f"{RDF}rest"] * 2 + [named(each).value for each in ("q", "p", "p", "r")]
    )
    by = {quad.predicate: quad for quad in quads}
    assert by[named("q")].object in [quad.subject for quad in quads if quad.predicate == named("p")]
    assert isinstance(by[named("r")].object, BlankNode)


def test_variables_may_stand_wherever_a_term_may_and_have_two_marks() -> None:
    operation = only("INSERT { ?s $p ( ?a [ ?q ?b ] ) . GRAPH ?g { ?s?p?o } } WHERE { ?s ?p ?o }")
    assert operation.where is not None
    assert set(operation.where.variables) == {"s", "p", "a", "q", "b", "g", "o"}
    assert (
        QuadTemplate(TemplateVariable("s"), TemplateVariable("p"), TemplateVariable("o"), TemplateVariable("g"))
        in operation.inserts
    )


def test_the_name_of_a_variable_may_begin_with_an_underscore_or_a_digit() -> None:
    operation = only("DELETE { ?_g0 <p> ?0 } INSERT { ?_ <p> ?__ } WHERE { ?_ <p> ?_g0, ?0, ?__ }")
    assert operation.where is not None
    assert set(operation.where.variables) == {"_g0", "0", "_", "__"}


def test_what_looks_like_the_mark_of_a_variable_is_none() -> None:
    assert objects("<a> <b> '?v' , <urn:x-hole:v> , '$w'") == [Literal("?v"), NamedNode("urn:x-hole:v"), Literal("$w")]


def test_full_stops_are_put_where_sparql_lets_them_be_left_out() -> None:
    quads = [quad.graph for quad in inserted(f"{ABC} GRAPH <g> {{ {ABC} . }} . {ABC} . GRAPH <g> {{ {ABC} }} {ABC} .")]
    assert [quad is not None for quad in quads] == [False, True, False, True, False]


def test_predicates_and_objects_may_be_listed() -> None:
    assert len(inserted("<a> a <c> , <d> ; <b> 1 , 2 ; .")) == 4
    assert inserted("<a> a <c>")[0].predicate == NamedNode(f"{RDF}type")


# What is wrong


@pytest.mark.parametrize(
    ("text", "words"),
    [
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
        ("INSERT DATA { ?s <b> <c> }", "?s stands in the INSERT DATA at 1:13"),
        ("DELETE DATA { <a> <b> ?o }", "?o stands in the DELETE DATA at 1:13"),
        ("DELETE DATA { _:x <b> <c> }", "blank node stands in the DELETE at 1:13"),
        ("DELETE DATA { <a> <b> [] }", "blank node stands in the DELETE at 1:13"),
        ("DELETE { <a> <b> ( 1 ) } WHERE { }", "blank node stands in the DELETE at 1:8"),
        ("DELETE WHERE { _:x <b> ?o }", "blank node stands in the DELETE at 1:14"),
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
        ("INSERT DATA { <a> <b> 'x }", "string that begins at 1:23 has no end"),
        ("INSERT DATA { <a> <b> <c d> }", "< at 1:23 begins no IRI"),
        ("INSERT DATA { <http://[/> <b> <c> }", "1:15"),
        ("INSERT DATA { << <a> <b> <c> >> <b> <c> }", "<< at 1:15"),
        ("INSERT { } WHERE { SERVICE <s> { } }", "SERVICE at 1:20"),
        ("INSERT DATA { \\u003ca> <b> <c> }", "1:15"),
    ],
)
def test_a_wrong_text_is_refused_where_it_is_wrong(text: str, words: str) -> None:
    assert words in refusal(text)


def test_nesting_and_length_are_bounded() -> None:
    deep = f"INSERT DATA {{ <a> <b> {'( ' * 200}{' )' * 200} }}"
    assert "nests deeper than 128" in refusal(deep)
    many = ";".join(["INSERT DATA { }"] * 2000)
    assert "at most 1000 are taken" in refusal(many)
    with pytest.raises(Problem) as caught:
        read(f"INSERT DATA {{ {ABC} }}", bounds=QueryBounds(size=10))
    assert caught.value.status == 413
