"""Mapping documents: their meaning, and every reason for rejecting one."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from contextlib import suppress
from functools import cache
from importlib.resources import files
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pyoxigraph import BlankNode, Literal, NamedNode, Triple

from rosld.ontology.body import RdfBody
from rosld.ontology.document import Document
from rosld.ontology.serialize import serialize
from rosld.ontology.syntax import Syntax
from rosld.ontology.urls import Space
from rosld.ontology.violations import Violation
from rosld.ontology.vocab import av, mapping, rdf, sh, xsd
from rosld.server.hypermedia import mapping_parser
from rosld.server.hypermedia.mapping import ComplexResource
from rosld.server.hypermedia.mapping_parser import (
    MAX_TRIPLES,
    InvalidMapping,
    MappingDocument,
    load_mapping,
    mapping_of,
    read_mapping,
)
from rosld.server.robot.software_stop import StopCommand

SPACE = Space("http://127.0.0.1:8080/")
URL = "http://127.0.0.1:8080/mappings/aircraft"
TURTLE = "text/turtle"
AIRCRAFT = Path(str(files("rosld.adapters.aircraft"))) / "mapping.ttl"
TEXT = AIRCRAFT.read_text()
GUIDE = Path(__file__).parents[3] / "docs" / "reference" / "resources.md"
PREFIXES = """
@prefix map: <https://w3id.org/rosld/mapping#> .
@prefix av: <https://w3id.org/rosld/aircraft#> .
@prefix qudt: <http://qudt.org/schema/qudt/> .
@prefix ldp: <http://www.w3.org/ns/ldp#> .
@prefix rdf: <http://www.w3.org/1999/02/22-rdf-syntax-ns#> .
@prefix rdfs: <http://www.w3.org/2000/01/rdf-schema#> .
@prefix sh: <http://www.w3.org/ns/shacl#> .
@prefix unit: <http://qudt.org/vocab/unit/> .
@prefix quantitykind: <http://qudt.org/vocab/quantitykind/> .
"""
SHAPE = '[ a sh:NodeShape ; map:about "/a/" ; sh:property [ sh:path av:p ; sh:minInclusive 1 ] ]'


def read(turtle: str) -> MappingDocument:
    return read_mapping((PREFIXES + turtle).encode(), TURTLE, URL)


def refused(turtle: str) -> tuple[Violation, ...]:
    with pytest.raises(InvalidMapping) as found:
        read(turtle)
    assert found.value.violations
    return found.value.violations


def resource(inner: str) -> ComplexResource:
    """Return the complex resource of path `/a/` with these statements."""
    (found,) = read(f'<#a> a map:ComplexResource ; map:path "/a/" ; {inner} .').resources
    return found


@cache
def aircraft() -> MappingDocument:
    return load_mapping(AIRCRAFT, SPACE, "aircraft")


def test_what_stops_the_robot_is_a_call_or_a_message_with_full_names_and_json() -> None:
    [stops] = [[each.command for each in one.stops] for one in aircraft().resources if one.stops]
    assert stops == [
        StopCommand("/aircraft/engine/set_speed", None, '{"data": 0}'),
        StopCommand(None, "/cockpit/display", '{"data": "stopped"}'),
    ]


def test_what_stops_nothing_is_refused() -> None:
    wrong = {
        "[]": "map:call",
        '[ map:call "a" ; map:publish "b" ]': "not both",
        '[ map:call "a" ; map:content "[]" ]': "an object",
        '[ map:call "a" ; map:content "{" ]': "an object",
        '[ map:call "a" ; map:when <#x> ]': "nothing else",
        '"stop"': "holds a node",
    }
    for stop, words in wrong.items():
        assert words in str(refused(f'<#a> a map:ComplexResource ; map:path "/a/" ; map:stop {stop} .'))


# Valid documents


def test_the_title_is_a_label_in_english_or_no_language_first() -> None:
    titles = {
        "": None,
        'rdfs:label "Plane" ;': "Plane",
        'rdfs:label "Flugzeug"@de , "Plane"@en ;': "Plane",
        'rdfs:label "Flugzeug"@de , "Avion"@fr ;': "Flugzeug",
    }
    for labels, title in titles.items():
        assert resource(f"{labels} map:link [ map:relation av:engine ; map:target '/b/' ]").title == title


def test_a_condition_in_brackets_works_and_gets_a_name_that_the_document_does_not_use() -> None:
    first, second = resource(
        "map:property [ map:predicate av:p ; map:member 'p' ] ; rdfs:seeAlso <#condition.1> ; "
        f"map:existsWhen {SHAPE} , {SHAPE}"
    ).exists_when
    assert (first.iri, second.iri) == (f"{URL}#condition.2", f"{URL}#condition.3")
    assert first.about == "/a/"
    focus = NamedNode("http://x/a/")
    assert first.shape.violations(focus, [Triple(focus, NamedNode(f"{av.iri}p"), Literal(0))])


# Violations of the shape, inside a complex resource of path /a/

CONDITION = "a sh:NodeShape ; sh:property [ sh:path av:p ; sh:minCount 1 ]"
WRONG: tuple[tuple[str, str, tuple[str, ...]], ...] = (
    # the violation's place, a template, and the invalid statement at that place
    ("predicate", 'map:property [ map:member "p" {} ]', ("", '; map:predicate "p"', "; map:predicate av:p , av:q")),
    ("predicate", 'map:property [ map:predicate {} ; map:member "p" ]', ("rdf:type", "ldp:contains")),
    ("member", "map:property [ map:predicate av:p {} ]", ("", '; map:member "p" , "q"', "; map:member <p>")),
    ("member", "map:property [ map:predicate av:p ; map:member {} ]", ("1", '"p"@en', '""', '"p/"', '"/p//q"')),
    ("member", "map:property [ map:predicate av:p ; map:member {} ]", ('"p\\n"',)),
    ("name", 'map:property [ map:predicate av:p ; map:member "p" ; map:name {} ]', ('"a/b"', '""', '"a" , "b"')),
    ("field", 'map:property [ map:predicate av:p ; map:member "p" ; map:field {} ]', ('"x/y"', '"x."', '""', '"x\\n"')),
    ("field", 'map:property [ map:predicate av:p ; map:member "p" ; map:field {} ]', ('"x" , "y"',)),
    ("hasUnit", 'map:property [ map:predicate av:p ; map:member "p" ; qudt:hasUnit {} ]', ('"m"',)),
    ("hasUnit", 'map:property [ map:predicate av:p ; map:member "p" ; qudt:hasUnit {} ]', ("unit:M , unit:S",)),
    ("hasQuantityKind", "map:property [ map:predicate av:p ; map:member 'p' ; qudt:hasQuantityKind {} ]", ('"m"',)),
    ("service", 'map:property [ map:predicate av:p ; map:member "p" ; map:service {} ]', ('"s"',)),
    ("availableWhen", 'map:property [ map:predicate av:p ; map:member "p" ; map:availableWhen {} ]', (SHAPE,)),
    ("feld", 'map:property [ map:predicate av:p ; map:member "p" ; map:feld {} ]', ('"x"',)),
    ("relation", "map:action [ {} ]", ('map:service "s"',)),
    ("service", "map:action [ map:relation av:start {} ]", ("", '; map:service "s" , "t"')),
    ("name", 'map:action [ map:relation av:start ; map:service "s" ; map:name {} ]', ('"a" , "b"',)),
    ("target", 'map:action [ map:relation av:start ; map:service "s" ; map:target {} ]', ('"/b/"',)),
    ("writableWhen", 'map:action [ map:relation av:start ; map:service "s" ; map:writableWhen {} ]', (SHAPE,)),
    ("relation", "map:link [ {} ]", ('map:target "/b/"',)),
    ("target", "map:link [ map:relation av:engine {} ]", ("", '; map:target "/b"', "; map:target </resources/b/>")),
    ("target", "map:link [ map:relation av:engine ; map:target {} ]", ('"/b/" , "/c/"',)),
    ("name", 'map:link [ map:relation av:engine ; map:target "/b/" ; map:name {} ]', ('"b"',)),
    *((name, f"map:{name} {{}}", ('"x"',)) for name in ("property", "action", "link", "exists", "existsWhen")),
    ("path", "map:path {}", ('"/b/"',)),
    ("label", "rdfs:label {}", ("[ rdfs:label 'x' ]",)),
    ("x:y", "<x:y> {}", ('"z"',)),
    ("type", "map:existsWhen [ map:about {} ; sh:minLength 1 ]", ('"/a/"',)),
    ("about", "map:existsWhen {}", ("<#nowhere>", f"[ {CONDITION} ]")),
    ("about", f"map:existsWhen [ {CONDITION} ; map:about {{}} ]", ('"/b/" , "/c/"', '"b"', "</a/>")),
)


def test_the_shape_of_mappings_refuses_what_is_wrong_and_says_where() -> None:
    wrong = []
    for blamed, template, values in WRONG:
        for inner in map(template.format, values):
            found = refused(f'<#a> a map:ComplexResource ; map:path "/a/" ; {inner} .')
            assert all(one.message.endswith((".", "?")) and one.component and one.focus for one in found)
            if not any(one.path.endswith((blamed, f"{blamed}>")) for one in found):
                wrong.append((inner, found))
    assert not wrong, wrong


def test_a_complex_resource_has_an_iri_a_type_and_a_path_that_begins_and_ends_with_a_slash() -> None:
    for path in ("aircraft/", "/aircraft", "", "//", "/a//b/", "/a/\n", "/a\u0007/"):
        (found,) = refused(f"<#a> a map:ComplexResource ; map:path {Literal(path)} .")
        assert (found.path, found.predicate) == ("<#a> map:path", mapping.path)
        assert found.focus == NamedNode(f"{URL}#a")
    for path in ("/", "/a/", "/a/b/", "/ä ö/", "/~/"):
        assert read(f"<#a> a map:ComplexResource ; map:path {Literal(path)} .").resources[0].path == path
    assert [one.path for one in refused("<#a> a map:ComplexResource .")] == ["<#a> map:path"]
    assert [one.path for one in refused('<#a> map:path "/a/" .')] == ["<#a> rdf:type"]
    assert "IRI of its own" in refused('[] a map:ComplexResource ; map:path "/a/" .')[0].message


def test_two_complex_resources_with_one_path_are_refused() -> None:
    (found,) = refused('<#a> a map:ComplexResource ; map:path "/a/" . <#b> a map:ComplexResource ; map:path "/a/" .')
    assert found.path == "<#b> map:path"
    assert "<#a>" in found.message


def test_names_and_predicates_that_collide_are_refused() -> None:
    first = 'map:property [ map:predicate av:p ; map:member "b/x" ]'
    for second in (
        'map:property [ map:predicate av:q ; map:member "c/x" ]',
        'map:property [ map:predicate av:q ; map:member "b" ; map:field "x" ]',
        'map:action [ map:relation av:q ; map:service "b/x" ]',
    ):
        (found,) = refused(f'<#a> a map:ComplexResource ; map:path "/a/" ; {first} ; {second} .')
        assert found.value == "x"
        assert "map:name" in found.message
    both = "".join(f"<#{name}> a map:ComplexResource ; map:path '/{name}/' ; {first} . " for name in "ab")
    assert len(read(both).resources) == 2
    (found,) = refused(TEXT.replace("av:direction", "av:speed"))
    assert "av:speed" in found.message


def test_a_misspelt_term_is_refused_with_a_similar_one() -> None:
    for wrong, right in (("sh:hasvalue", "sh:hasValue"), ("sh:Path", "sh:path"), ("map:abuot", "map:about")):
        (found,) = refused(f"<#a> a map:ComplexResource ; map:path '/a/' . <x:y> {wrong} 1 .")
        assert found.message == f"{wrong} does not exist; {right} does"


def with_condition(shape: str, about: str = "/b/") -> str:
    """Return a mapping with a condition that has these statements."""
    condition = f"[ a sh:NodeShape ; map:about '{about}' ; {shape} ]"
    return f"<#a> a map:ComplexResource ; map:path '/a/' ; map:existsWhen {condition} ."


def test_a_condition_that_demands_nothing_is_refused() -> None:
    for shape in (
        "sh:message 'always'",
        "sh:property [ sh:path av:p ]",
        "sh:property [ sh:path av:p ; sh:name 'p' ] , [ sh:path av:q ; sh:minCount 1 ]",
        "sh:property [ sh:path av:p ; sh:property [ sh:path av:q ] ]",
        "sh:severity sh:Warning ; sh:targetClass av:X",
    ):
        (found,) = refused(with_condition(shape))
        assert "has no constraints" in found.message


def test_a_condition_that_cannot_be_judged_is_refused() -> None:
    for shape in (
        "sh:property [ sh:minCount 1 ]",
        "sh:property [ sh:path av:p , av:q ; sh:minCount 1 ]",
        "sh:property [ sh:path 'p' ; sh:minCount 1 ]",
        "sh:property [ sh:path av:p ; sh:minCount 'many' ]",
        "sh:property [ sh:path av:p ; sh:pattern '(' ]",
        "sh:property [ sh:path av:p ; sh:pattern '(?=a)' ]",
        "sh:property [ sh:path av:p ; sh:in 1 ]",
        "sh:property <#nowhere>",
        "sh:node <#nowhere>",
        "sh:sparql [ sh:select 'SELECT $this WHERE { $this ?p ?o }' ]",
        "sh:not 'x'",
    ):
        found = refused(with_condition(shape))
        assert all(one.path.startswith(("<#condition.1>", "<#nowhere>")) for one in found), found


def test_a_condition_that_looks_at_what_its_resource_does_not_have_is_refused() -> None:
    (found,) = refused(TEXT.replace("sh:path av:speed", "sh:path av:sped"))
    assert found.path == "<#standing>"
    assert "has no av:sped" in found.message
    assert "av:direction, av:speed" in found.message
    (found,) = refused(with_condition("sh:property [ sh:path av:p ; sh:minCount 1 ]", "/a/p"))
    assert "rdf:value" in found.message


def test_a_triple_term_is_refused() -> None:
    (found,) = refused(TEXT + "<x:a> <x:b> <<( <x:c> <x:d> <x:e> )>> .")
    assert "triple term" in found.message


DEEP = {
    "a chain of shapes": "<#c0> a sh:NodeShape ; map:about '/b/' . "
    + "".join(f"<#c{n}> sh:property <#c{n + 1}> . " for n in range(2000)),
    "a chain of nested shapes": "<#c0> a sh:NodeShape ; map:about '/b/' . "
    + "".join(f"<#c{n}> sh:node <#c{n + 1}> . " for n in range(2000)),
    "a chain of subclasses": "".join(f"<#c{n}> rdfs:subClassOf <#c{n + 1}> . " for n in range(2000))
    + "<#c2000> rdfs:subClassOf map:ComplexResource .",
}


@pytest.mark.slow
def test_depth_and_size_do_no_harm(monkeypatch: pytest.MonkeyPatch) -> None:
    for text in DEEP.values():
        with suppress(InvalidMapping):
            read(TEXT + text)
    refused(with_condition("sh:node <#c>") + "<#c> a sh:NodeShape ; map:about '/b/' ; sh:node <#c> .")
    (found,) = refused("".join(f"<#a{number}> <x:y> 1 . " for number in range(MAX_TRIPLES + 1)))
    assert str(MAX_TRIPLES) in found.message
    assert len(refused("".join(f"<#a{number}> map:path {number} . " for number in range(50)))) == 20
    monkeypatch.setattr(mapping_parser, "LONGEST_READING", -1.0)
    (found,) = refused(TEXT)
    assert "too large" in found.message


def test_a_file_may_be_in_any_syntax(tmp_path: Path) -> None:
    for syntax in Syntax:
        path = tmp_path / f"plane.{syntax.extension}"
        path.write_bytes(serialize(Document(f"{SPACE.base}mappings/plane", aircraft().triples), syntax))
        found = load_mapping(path, SPACE)
        assert [each.path for each in found.resources] == [each.path for each in aircraft().resources]
        assert len(found.triples) == len(aircraft().triples)


def test_every_mapping_in_the_guide_is_good() -> None:
    guide = re.findall(r"```turtle\n(.*?)```", GUIDE.read_text("utf-8"), re.DOTALL)
    mappings = [text for text in guide if "map:ComplexResource" in text]
    assert mappings
    for text in mappings:
        assert read_mapping(text.encode(), TURTLE, URL).resources


@st.composite
def damaged(draw: st.DrawFn) -> RdfBody:
    """Return the aircraft's mapping with a few triples removed, changed or added."""
    triples = list(aircraft().triples)
    subjects = sorted({one.subject for one in triples}, key=str)
    predicates = sorted({*(one.predicate for one in triples), *mapping.terms.values(), *sh.terms.values()}, key=str)
    objects: Sequence[object] = [
        *sorted({one.object for one in triples}, key=str),
        *(Literal(text) for text in ("", "/", "x", "/a/b/", "a\nb")),
        Literal("1", datatype=xsd.integer),
        Literal("many", datatype=xsd.integer),
        Literal("x", language="en"),
        rdf.nil,
        sh.NodeShape,
        BlankNode("new"),
        *subjects,
    ]
    for _ in range(draw(st.integers(1, 4))):
        place = draw(st.integers(0, len(triples) - 1))
        match draw(st.sampled_from(["remove", "object", "predicate", "subject", "add"])):
            case "remove":
                triples.pop(place)
            case "object":
                triples[place] = Triple(
                    triples[place].subject, triples[place].predicate, draw(st.sampled_from(objects))
                )
            case "predicate":
                triples[place] = Triple(
                    triples[place].subject, draw(st.sampled_from(predicates)), triples[place].object
                )
            case "subject":
                triples[place] = Triple(
                    draw(st.sampled_from(subjects)), triples[place].predicate, triples[place].object
                )
            case _:
                triples.append(
                    Triple(
                        draw(st.sampled_from(subjects)),
                        draw(st.sampled_from(predicates)),
                        draw(st.sampled_from(objects)),
                    )
                )
    return _body(triples)


def _body(triples: Iterable[Triple]) -> RdfBody:
    subjects: dict[object, dict[NamedNode, list[object]]] = {}
    for subject, predicate, object in triples:
        subjects.setdefault(subject, {}).setdefault(predicate, []).append(object)
    return RdfBody(subjects, len(list(triples)))


@pytest.mark.slow
@settings(max_examples=50, deadline=None)
@given(damaged())
def test_a_damaged_mapping_is_taken_or_refused_with_a_reason(body: RdfBody) -> None:
    match outcome(body):
        case InvalidMapping() as error:
            assert 1 <= len(error.violations) <= 20
            assert all(one.message for one in error.violations)
        case found:
            assert found.resources
            assert len({one.path for one in found.resources}) == len(found.resources)


def outcome(body: RdfBody) -> MappingDocument | InvalidMapping:
    """Return the result of a body; any other exception is a fault."""
    try:
        return mapping_of(body, URL)
    except InvalidMapping as error:
        return error
