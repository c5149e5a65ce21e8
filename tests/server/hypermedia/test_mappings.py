"""Mappings in force: replaced whole or not at all; and what is looked up in them."""

from __future__ import annotations

from collections.abc import Iterable
from importlib.resources import files
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rosld.ontology.urls import Space
from rosld.server.hypermedia.mapping import Condition, MappingSet
from rosld.server.hypermedia.mapping_parser import InvalidMapping, MappingDocument, load_mapping, read_mapping
from rosld.server.hypermedia.mappings import (
    Mappings,
    actions_by_service,
    connected_paths,
    dependents,
    mapped_above,
    write_conditions_of,
)

SPACE = Space("http://127.0.0.1:8080/")
AIRCRAFT = load_mapping(Path(str(files("rosld.adapters.aircraft"))) / "mapping.ttl", SPACE, "aircraft")
PREFIXES = """
@prefix map: <https://w3id.org/rosld/mapping#> .
@prefix : <https://example.org/robot#> .
@prefix rdf: <http://www.w3.org/1999/02/22-rdf-syntax-ns#> .
@prefix sh: <http://www.w3.org/ns/shacl#> .
"""


def document(name: str, text: str) -> MappingDocument:
    return read_mapping((PREFIXES + text).encode(), "text/turtle", f"{SPACE.base}mappings/{name}")


def resource(path: str, inner: str = "") -> str:
    """A complex resource; its IRI is made of its path."""
    return f'<#r{path.replace("/", "-")}> a map:ComplexResource ; map:path "{path}" {inner} .\n'


def about(place: str) -> str:
    """A condition in brackets about a path, or about a name."""
    seen = ":p" if place.endswith("/") else "rdf:value"
    return f'[ a sh:NodeShape ; map:about "{place}" ; sh:property [ sh:path {seen} ; sh:minInclusive 1 ] ]'


def having(member: str, *, when: str = "") -> str:
    return f'; map:property [ map:predicate :p ; map:member "{member}" {when} ]'


def arranged(*documents: MappingDocument) -> MappingSet:
    mappings = Mappings()
    for each in documents:
        mappings.replace(each)
    return mappings.mapping_set


def abouts(conditions: Iterable[Condition]) -> list[str]:
    return sorted(each.about for each in conditions)


def test_documents_come_into_force_are_replaced_and_go_each_time_with_another_revision() -> None:
    mappings = Mappings()
    assert mappings.mapping_set == MappingSet()
    revisions = [mappings.mapping_set.revision]
    for paths in ("ab", "bc", "bc"):
        mappings.replace(document("a", "".join(resource(f"/{path}/") for path in paths)))
        assert set(mappings.mapping_set.resources) == {f"/{path}/" for path in paths}
        assert list(mappings.documents) == [f"{SPACE.base}mappings/a"]
        revisions.append(mappings.mapping_set.revision)
    mappings.remove(f"{SPACE.base}mappings/none")
    assert mappings.mapping_set.revision == revisions[-1]
    mappings.remove(f"{SPACE.base}mappings/a")
    assert not mappings.mapping_set.resources
    assert not mappings.documents
    assert len({*revisions, mappings.mapping_set.revision}) == 5


def test_what_was_handed_out_never_changes() -> None:
    mappings = Mappings()
    mappings.replace(document("a", resource("/a/")))
    mapping_set, documents = mappings.mapping_set, mappings.documents
    mappings.replace(document("b", resource("/b/")))
    mappings.remove(f"{SPACE.base}mappings/a")
    assert set(mapping_set.resources) == {"/a/"}
    assert list(documents) == [f"{SPACE.base}mappings/a"]
    with pytest.raises(TypeError):
        mapping_set.resources["/x/"] = mapping_set.resources["/a/"]  # type: ignore[index]


def test_a_document_that_describes_anothers_condition_is_refused() -> None:
    shape = '<http://x/c> a sh:NodeShape ; map:about "/z/" ; sh:property [ sh:path :p ; sh:minCount 1 ] .'
    mappings = Mappings()
    mappings.replace(document("a", resource("/a/", "; map:existsWhen <http://x/c>") + shape))
    with pytest.raises(InvalidMapping, match="http://x/c"):
        mappings.replace(document("b", resource("/b/", "; map:existsWhen <http://x/c>") + shape))
    mappings.replace(document("a", resource("/a/")))
    mappings.replace(document("b", resource("/b/", "; map:existsWhen <http://x/c>") + shape))


def test_the_write_conditions_of_a_member_are_those_of_all_its_mappings_each_once() -> None:
    mapping_set = arranged(
        document("a", resource("/a/", having("p", when=f"; map:writableWhen {about('/x/')}"))),
        document("b", resource("/b/", having("/a/p", when=f"; map:writableWhen {about('/y/')} , {about('/z/')}"))),
        document("c", resource("/c/", having("/a/p", when='; map:field "x"'))),
    )
    assert abouts(write_conditions_of(mapping_set, "/a/p")) == ["/x/", "/y/", "/z/"]
    assert write_conditions_of(mapping_set, "/a/q") == ()
    when = "; map:writableWhen <#c>"
    shape = '<#c> a sh:NodeShape ; map:about "/x/" ; sh:property [ sh:path :p ; sh:minCount 1 ] .'
    both = document("a", resource("/a/", having("p", when=when)) + resource("/b/", having("/a/p", when=when)) + shape)
    assert len(write_conditions_of(arranged(both), "/a/p")) == 1


def test_actions_are_found_by_the_service_behind_them() -> None:
    action = '; map:action [ map:relation :go ; map:name "{}" ; map:service "/s" ]'
    mapping_set = arranged(document("a", resource("/a/", action.format("go")) + resource("/b/", action.format("run"))))
    found = actions_by_service(mapping_set)
    assert set(found) == {"/s"}
    assert [(one.path, action.name) for one, action in found["/s"]] == [("/a/", "go"), ("/b/", "run")]
    assert set(actions_by_service(arranged(AIRCRAFT))) == {"/aircraft/start", "/aircraft/stop"}


def test_dependents_have_a_condition_of_any_kind_about_a_place() -> None:
    wanting = f"; map:existsWhen {about('/x/')}"
    writing = having("p", when=f"; map:writableWhen {about('/x/')}")
    acting = f'; map:action [ map:relation :go ; map:service "go" ; map:availableWhen {about("/x/")} ]'
    linking = f'; map:link [ map:relation :to ; map:target "/x/" ; map:availableWhen {about("/x/")} ]'
    naming = f"; map:existsWhen {about('/x/p')}"
    kinds = {"/a/": wanting, "/b/": writing, "/c/": acting, "/d/": linking, "/e/": naming, "/f/": ""}
    mapping_set = arranged(document("all", "".join(resource(path, inner) for path, inner in kinds.items())))
    assert dependents(mapping_set, "/x/") == {"/a/", "/b/", "/c/", "/d/"}
    assert dependents(mapping_set, "/x/p") == {"/e/"}
    assert dependents(mapping_set, "/f/") == frozenset()


def test_paths_are_connected_by_conditions_in_any_number_of_steps() -> None:
    mapping_set = arranged(
        document("a", resource("/a/", f"; map:existsWhen {about('/b/')}") + resource("/b/", having("p"))),
        document("c", resource("/c/", f"; map:existsWhen {about('/b/')}")),
        document("d", resource("/d/", f"; map:existsWhen {about('/c/')}")),
        document("e", resource("/e/") + resource("/f/", f"; map:existsWhen {about('/g/p')}")),
        document("h", resource("/h/", having("/g/p")) + resource("/i/", having("/g/q"))),
    )
    for path in ("/a/", "/b/", "/c/", "/d/"):
        assert connected_paths(mapping_set, path) == {"/a/", "/b/", "/c/", "/d/"}
    for path in ("/f/", "/g/", "/h/"):  # by a property that one names and another shows
        assert connected_paths(mapping_set, path) == {"/f/", "/g/", "/h/"}
    for path in ("/e/", "/i/", "/nowhere/"):
        assert connected_paths(mapping_set, path) == {path}


def test_what_covers_a_place_is_mapped_at_or_above_it_the_outermost_first() -> None:
    mapping_set = arranged(document("a", resource("/") + resource("/a/") + resource("/a/b/c/") + resource("/ab/")))

    def paths(place: str) -> list[str]:
        return [one.path for one in mapped_above(mapping_set, place)]

    assert paths("/a/b/c/") == ["/", "/a/", "/a/b/c/"]
    assert paths("/a/b/c/d") == ["/", "/a/", "/a/b/c/"]
    assert paths("/a/b/c") == ["/", "/a/"]
    assert paths("/ab/x") == ["/", "/ab/"]
    assert paths("/") == ["/"]
    assert [one.path for one in mapped_above(arranged(AIRCRAFT), "/cockpit/display")] == []


PATHS = st.sampled_from([f"/{one}/" for one in "abcdef"])


@pytest.mark.slow
@settings(max_examples=40)
@given(st.dictionaries(PATHS, st.lists(st.one_of(PATHS, PATHS.map(lambda path: f"{path}p")), max_size=2), max_size=6))
def test_connected_paths_partition_all_paths(conditions: dict[str, list[str]]) -> None:
    texts = [
        resource(path, "".join(f"; map:existsWhen {about(place)}" for place in places) + having("p"))
        for path, places in conditions.items()
    ]
    if not texts:
        return
    mapping_set = arranged(document("all", "".join(texts)))
    for path, places in conditions.items():
        together = connected_paths(mapping_set, path)
        assert path in together
        assert all(connected_paths(mapping_set, other) == together for other in together)
        assert {place.rpartition("/")[0] + "/" for place in places} <= together
        for place in places:
            assert path in dependents(mapping_set, place)
