"""PATCH: JSON merge patch (RFC 7396) and SPARQL Update on one resource. Pure."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence, Set
from typing import TypeAlias

from pyoxigraph import Literal, NamedNode, Quad, Store, Triple

from rosld.ontology.body import RdfBody, indexed
from rosld.ontology.vocab import rdf, xsd
from rosld.server.http.problem import Problem
from rosld.server.sparql.lexer import check_update_of_one_graph, tokens


def merge_patch(target: object, patch: object) -> object:
    """`target` changed as `patch` says (RFC 7396 2): null removes, objects merge, all else replaces."""
    if not isinstance(patch, dict):
        return patch
    merged = dict(target) if isinstance(target, dict) else {}
    for name, value in patch.items():
        if value is None:
            merged.pop(name, None)
        else:
            merged[name] = merge_patch(merged.get(name), value)
    return merged


class Grown(Exception):
    """More triples came of a patch than there may be."""


def updated(data: bytes, before: Iterable[Triple], base: str, most: int | None = None) -> RdfBody:
    """The triples of one resource after a SPARQL Update, whose default graph is that resource's own.

    Raises Problems: 400 for what cannot be parsed, 422 for what reaches beyond the one graph (GRAPH, WITH, USING, LOAD,
    SERVICE, whole-graph operations). Raises Grown where more than `most` triples come of it.
    """
    text = _text(data)
    check_update_of_one_graph(text)
    store = Store()
    said = tuple(before)
    store.extend(Quad(triple.subject, triple.predicate, triple.object) for triple in said)
    try:
        store.update(text, base_iri=base)
    except SyntaxError as error:
        raise Problem(400, f"The update cannot be parsed: {error}.") from error
    except (OSError, RuntimeError, ValueError) as error:
        raise Problem(422, f"The update cannot be carried out: {error}.") from error
    if most is not None and len(store) > most:
        raise Grown
    return indexed(_as_spelt(store, said), base)


def deletes(update: bytes) -> bool:
    """Whether a SPARQL Update has an operation that deletes. Raises a 400 Problem for what is no UTF-8."""
    return any(token.is_word("DELETE") for token in tokens(_text(update)))


def _text(update: bytes) -> str:
    try:
        return update.decode("utf-8")
    except UnicodeDecodeError as error:
        raise Problem(400, f"The update is not UTF-8: {error.reason} at byte {error.start}.") from error


def spelt(after: Iterable[Triple], before: Iterable[Triple]) -> list[Triple]:
    """Triples of a store, with the literals that were there before spelt as they were."""
    triples, said = list(after), tuple(before)
    spellings = _spellings(triples, said)
    if not spellings:
        return triples
    there = set(said)
    return [each for triple in triples for each in _as_they_were(triple, spellings, there)]


def _as_spelt(after: Iterable[Quad], before: Sequence[Triple]) -> Iterator[Quad]:
    """Quads of a store, with the literals that were there before spelt as they were."""
    quads = list(after)
    spellings = _spellings(quads, before)
    there = set(before) if spellings else set()
    for quad in quads:
        for subject, predicate, object in _as_they_were(quad.triple, spellings, there):
            yield Quad(subject, predicate, object, quad.graph_name)


_Spellings: TypeAlias = "Mapping[Literal, Sequence[Literal]]"
"""Ways to write a literal, by the one in which a store gives it back."""


def _spellings(after: Iterable[Triple | Quad], before: Sequence[Triple]) -> _Spellings:
    """How literals were written that a store may have given back otherwise: it keeps values only, and 01 is 1 to it."""
    kept = {each.object for each in after}
    others = [
        each.object
        for each in before
        if isinstance(each.object, Literal) and each.object.datatype != xsd.string and each.object not in kept
    ]
    found: dict[Literal, list[Literal]] = {}
    for literal, normal in _normal(others) if others else ():
        found.setdefault(normal, [normal]).append(literal)
    return found


def _as_they_were(triple: Triple, spellings: _Spellings, there: Set[Triple]) -> Sequence[Triple]:
    """A triple as it was written before: as often as it was, and as it is where it was not there."""
    spelt = spellings.get(triple.object, ()) if isinstance(triple.object, Literal) else ()
    known = [each for each in (Triple(triple.subject, triple.predicate, one) for one in spelt) if each in there]
    return known or (triple,)


def _normal(literals: Iterable[Literal]) -> Iterator[tuple[Literal, Literal]]:
    """Each of these literals, and as what a store gives it back."""
    numbered = dict(enumerate(dict.fromkeys(literals)))
    store = Store()
    store.extend(Quad(NamedNode(f"urn:x-literal:{number}"), rdf.value, each) for number, each in numbered.items())
    for quad in store:
        if isinstance(quad.subject, NamedNode) and isinstance(quad.object, Literal):
            yield numbered[int(quad.subject.value.rpartition(":")[2])], quad.object
