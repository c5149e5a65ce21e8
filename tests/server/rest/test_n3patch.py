"""N3 patches (Solid Protocol 5.3.1)."""

from __future__ import annotations

import time

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pyoxigraph import BlankNode, Literal, NamedNode, RdfFormat, Triple, parse

from rosld.ontology.vocab import xsd
from rosld.server.http.problem import Problem
from rosld.server.patches.n3patch import MAX_BYTES, MAX_PATTERNS, N3Patch, apply_patch, read_patch

BASE = "http://host/data/kitchen"
PREFIXES = "@prefix solid: <http://www.w3.org/ns/solid/terms#> . @prefix ex: <http://example.org/> . "


def patch(text: str, base: str = BASE) -> N3Patch:
    return read_patch((PREFIXES + text).encode(), base)


def insert_delete(where: str = "", deletes: str = "", inserts: str = "") -> N3Patch:
    return patch(
        f"_:p a solid:InsertDeletePatch ; solid:where {{ {where} }} ; solid:deletes {{ {deletes} }} ; "
        f"solid:inserts {{ {inserts} }} ."
    )


def triples(turtle: str) -> list[Triple]:
    text = f"@prefix ex: <http://example.org/> . {turtle}"
    return [quad.triple for quad in parse(text.encode(), RdfFormat.TURTLE, base_iri=BASE)]


def refusal(text: str) -> Problem:
    with pytest.raises(Problem) as refused:
        patch(text)
    return refused.value


def conflict(found: N3Patch, before: list[Triple]) -> str:
    with pytest.raises(Problem) as refused:
        apply_patch(found, before)
    assert refused.value.status == 409
    return refused.value.detail


def test_triples_are_deleted_and_inserted_in_order() -> None:
    before = triples("<> ex:a 1, 2, 3 .")
    assert apply_patch(insert_delete(inserts="<> ex:a 4 ."), before) == triples("<> ex:a 1, 2, 3, 4 .")
    assert apply_patch(insert_delete(deletes="<> ex:a 2"), before) == triples("<> ex:a 1, 3 .")
    for same in ("<> ex:a 1 .", ""):
        assert apply_patch(insert_delete(inserts=same), before) == before
    there = triples("<> ex:a 1 .")
    assert apply_patch(insert_delete(deletes="<> ex:a 1 .", inserts="<> ex:a 1 ."), there) == there
    assert apply_patch(patch("<#p> a solid:InsertDeletePatch ."), before) == before
    assert apply_patch(insert_delete(inserts="<> ex:a 1 ."), []) == there
    found = insert_delete("<> ex:a 1 .", inserts="<> ex:b 2 .")
    assert apply_patch(found, there) == triples("<> ex:a 1 ; ex:b 2 .")
    after = apply_patch(insert_delete("?a ex:b ?b .", inserts="<#a> ex:c <#b> ."), triples("<#x> ex:b <#y> ."))
    assert after == triples("<#x> ex:b <#y> . <#a> ex:c <#b> .")


def test_variables_stand_for_one_term_also_for_blank_nodes_of_the_resource() -> None:
    found = insert_delete("?a ex:knows ?a .", "?a ex:knows ?a .")
    assert apply_patch(found, triples("<#a> ex:knows <#b> . <#b> ex:knows <#b> .")) == triples("<#a> ex:knows <#b> .")
    before = triples("<> ex:part [ ex:name 'arm' ], [ ex:name 'leg' ] .")
    after = apply_patch(insert_delete("?p ex:name 'leg' .", "?p ex:name 'leg' .", "?p ex:name 'wheel' ."), before)
    part = next(each.subject for each in before if each.object == Literal("leg"))
    assert isinstance(part, BlankNode)
    assert Triple(part, NamedNode("http://example.org/name"), Literal("wheel")) in after
    found = insert_delete("<> ex:a ?a .", inserts="?a ex:b 1 .")
    assert "is not a valid triple" in conflict(found, triples("<> ex:a 'text' ."))


def test_blank_nodes_in_where_match_anything_and_in_any_number() -> None:
    before = triples("<#a> ex:part [], [], 'x' .")
    found = insert_delete("?a ex:part [] .", inserts="?a ex:whole true .")
    assert len(apply_patch(found, before)) == 4


def test_literals_keep_their_spelling_touched_and_untouched() -> None:
    before = triples("""<> ex:a "01"^^<http://www.w3.org/2001/XMLSchema#integer>, 1, "1.50"^^ex:mine .""")
    after = apply_patch(
        insert_delete(deletes="<> ex:a 1 .", inserts="<> ex:b +007, 1.50, 1E3, -.5e-1, true, 1 ."), before
    )
    objects = [each.object for each in after if isinstance(each.object, Literal)]
    assert [(each.value, each.datatype) for each in objects] == [
        ("01", xsd.integer),
        ("1.50", NamedNode("http://example.org/mine")),
        ("+007", xsd.integer),
        ("1.50", xsd.decimal),
        ("1E3", xsd.double),
        ("-.5e-1", xsd.double),
        ("true", xsd.boolean),
        ("1", xsd.integer),
    ]


def test_relative_iris_are_resolved_as_in_turtle() -> None:
    for reference in (
        *("", "#it", "#", "?q", "?q=1#it", "other", "./", "../up", "a/../b", "//h/x", "/top", "\\u0041"),
        *("höhe", "urn:a"),
    ):
        assert apply_patch(insert_delete(inserts=f"<{reference}> ex:a <> ."), []) == triples(f"<{reference}> ex:a <> .")


def test_whatever_turtle_writes_can_be_inserted() -> None:
    for statement in (
        "<> ex:a 'single', \"double\", '''long\n'one''', \"\"\"long \"one\"\"\" .",
        "<> ex:a 'tagged'@en-GB, 'q\\\"\\t\\u00e9'@fr, '1'^^ex:x .",
        "<> a ex:Thing ; ex:p ex:o ; .",
        "<> ex:empty () .",
    ):
        assert set(apply_patch(insert_delete(inserts=statement), [])) == set(triples(statement))


# Invalid patches (422) and invalid N3 (400)

PATCH = "_:p a solid:InsertDeletePatch ; "


def test_what_is_n3_but_no_patch_is_422_and_says_why() -> None:
    for text, words in (
        ("", "not 0"),
        ("<> ex:a 1 .", "not 0"),
        ("_:p a solid:Patch ; solid:inserts { <> ex:a 1 } .", "has no type"),
        (f"{PATCH} solid:inserts {{ }} . _:q solid:deletes {{ }} .", "not 2"),
        ("'p' a solid:InsertDeletePatch .", "IRI or a blank node"),
        (f"{PATCH} solid:inserts {{ }}, {{ <> ex:a 1 }} .", "solid:inserts at most once"),
        (f"{PATCH} solid:inserts 'x' .", "formula in braces"),
        (f"{PATCH} solid:where {{ <> ex:a {{ <> ex:b 1 }} }} .", "contains another"),
        (f"{PATCH} solid:inserts {{ {{ <> ex:b 1 }} ex:a 1 }} .", "contains another"),
        (f"{PATCH} solid:inserts {{ _:x ex:a 1 }} .", "blank node"),
        (f"{PATCH} solid:inserts {{ <> ex:a (1 2) }} .", "blank node"),
        (f"{PATCH} solid:deletes {{ <> ex:a _:x }} .", "blank node"),
        (f"{PATCH} solid:inserts {{ 'x' ex:a 1 }} .", "cannot be a literal"),
        (f"{PATCH} solid:where {{ ?a 'x' 1 }} .", "must be an IRI"),
        (f"{PATCH} solid:inserts {{ ?a ex:a 1 }} .", "variable ?a of solid:inserts"),
        (f"{PATCH} solid:where {{ ?a ex:a 1 }} ; solid:deletes {{ ?b ex:a 1 }} .", "variable ?b of solid:deletes"),
    ):
        problem = refusal(text)
        assert problem.status == 422
        assert words in problem.detail


def test_what_is_no_n3_is_400() -> None:
    for text in (
        "{",
        "_:p a",
        f"{PATCH} solid:inserts {{ <> ex:a }} .",
        f"{PATCH} solid:inserts {{ <> none:a 1 }} .",
        f"{PATCH} solid:inserts {{ <> ex:a 'x }} .",
        f"{PATCH} solid:inserts {{ <a b> ex:a 1 }} .",
        f"{PATCH} solid:inserts {{ <> ex:a 'x'@1-1 }} .",
        f"{PATCH} solid:inserts {{ <> ex:a '\\U00110000' }} .",
        f"{PATCH} solid:inserts {{ <> ex:a ?1 }} .",
        f"{PATCH} solid:inserts {{ <> ex:a 'x'^^<http://www.w3.org/1999/02/22-rdf-syntax-ns#langString> }} .",
        f"{PATCH} solid:inserts {{ <> ex:a 'x'^^?y }} .",
        f"{PATCH} solid:where {{$ ex:a $}} .",
        f"@forAll <#a> . {PATCH} solid:where {{ <#a> ex:a 1 }} .",
        f"@forSome <#a> . {PATCH} solid:where {{ }} .",
        "@prefix : <\x00> .",
        "<> ex:a <http://[> .",
        "\ud800",
    ):
        with pytest.raises(Problem) as refused:
            read_patch((PREFIXES + text).encode("utf-8", "surrogatepass"), BASE)
        assert refused.value.status == 400


def test_the_place_of_an_error_is_told() -> None:
    assert refusal(f"\n\n  {PATCH} solid:inserts {{ <> none:a 1 }} .").detail.startswith("line 3, column ")


def test_a_patch_that_is_too_large_is_refused_unread() -> None:
    with pytest.raises(Problem) as refused:
        read_patch(b"{" * (MAX_BYTES + 1), BASE)
    assert refused.value.status == 413


@pytest.mark.slow
def test_a_hostile_text_is_refused_soon() -> None:
    for data in (
        b"{" * 200_000,
        b"[ :p " * 100,
        b"(" * 120,
        b"<a> <b> " + b"[ <c> " * 127,
        b":a!:b" * 40_000,
        b"'" * 200_001,
        b"\\" * 200_000,
        b":a :b :c" + b";" * 200_000,
        b"<" * 100_000,
        b"_:a" * 80_000,
        b"\n#" * 100_000,
    ):
        began = time.thread_time()
        with pytest.raises(Problem) as refused:
            read_patch(data, BASE)
        assert refused.value.status in (400, 422)
        assert time.thread_time() - began < 10


def test_an_xml_literal_is_not_looked_into() -> None:
    bomb = '<!DOCTYPE a [<!ENTITY b \\"x\\">' + "".join(
        f'<!ENTITY c{number} \\"{"&b;" * 10}\\">' for number in range(10)
    )
    datatype = "<http://www.w3.org/1999/02/22-rdf-syntax-ns#XMLLiteral>"
    (after,) = apply_patch(insert_delete(inserts=f'<> ex:a "{bomb}"^^{datatype} .'), [])
    assert isinstance(after.object, Literal)
    assert after.object.value.startswith("<!DOCTYPE a")


@pytest.mark.slow
def test_a_search_without_end_is_given_up() -> None:
    before = triples(" ".join(f"<#{one}> ex:to <#{other}> ." for one in range(30) for other in range(30)))
    path = " ".join(f"?v{number} ex:to ?v{number + 1} ." for number in range(20))
    with pytest.raises(Problem) as refused:
        apply_patch(insert_delete(f"{path} ?v20 ex:never ex:there ."), before)
    assert refused.value.status in (409, 422)
    cycle = " ".join(f"[] ex:to [] . _:v{number} ex:to _:v{number + 1} ." for number in range(20))
    began = time.thread_time()
    with pytest.raises(Problem) as refused:
        apply_patch(insert_delete(f"{cycle} _:v20 ex:to _:none ."), before)
    assert refused.value.status == 422
    assert time.thread_time() - began < 10


def test_too_many_patterns_are_refused() -> None:
    where = " ".join(f"?a{number} ex:a 1 ." for number in range(MAX_PATTERNS + 1))
    assert refusal(f"{PATCH} solid:where {{ {where} }} .").status == 422


@pytest.mark.slow
def test_a_large_patch_of_a_large_resource_is_carried_out_soon() -> None:
    before = triples(" ".join(f"<#{number}> ex:is {number} ." for number in range(5000)))
    found = insert_delete(
        "?a ex:is 4711 .", " ".join(f"<#{number}> ex:is {number} ." for number in range(3000)), "?a ex:was 4711 ."
    )
    began = time.thread_time()
    assert len(apply_patch(found, before)) == 2001
    assert time.thread_time() - began < 5


_nodes = st.sampled_from(["<#a>", "<#b>", "<#c>"])
_statements = st.lists(st.tuples(_nodes, _nodes, _nodes | st.sampled_from(["1", "01", "'x'"])), max_size=8)


def _text(statements: list[tuple[str, str, str]]) -> str:
    return " ".join(" ".join(each) + " ." for each in statements)


@given(_statements, _statements, _statements)
def test_deletions_go_and_insertions_come_or_nothing_is_done(
    before: list[tuple[str, str, str]], deletes: list[tuple[str, str, str]], inserts: list[tuple[str, str, str]]
) -> None:
    there, gone, new = (set(triples(_text(each))) for each in (before, deletes, inserts))
    found = insert_delete(deletes=_text(deletes), inserts=_text(inserts))
    if gone <= there:
        assert set(apply_patch(found, triples(_text(before)))) == (there - gone) | new
    else:
        assert "does not exist" in conflict(found, triples(_text(before)))


_beginnings = st.text(max_size=200).map(lambda text: (PREFIXES + PATCH + text).encode("utf-8", "replace"))


@given(st.binary(max_size=200) | _beginnings)
def test_no_bytes_whatever_are_worse_than_a_refusal(data: bytes) -> None:
    try:
        read_patch(data, BASE)
    except Problem as problem:
        status = problem.status
    else:
        status = 200
    assert status in (200, 400, 422)
