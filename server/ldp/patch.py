"""PATCH: JSON merge patch (RFC 7396) and SPARQL Update on one resource. Pure."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from pyoxigraph import Literal, NamedNode, Quad, Store, Triple

from rosld.ontology.body import RdfBody, indexed
from rosld.ontology.vocab import rdf
from rosld.server.http.problem import Problem
from rosld.server.sparql.lexer import check_update_of_one_graph


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


def updated(data: bytes, before: Iterable[Triple], base: str) -> RdfBody:
    """The triples of one resource after a SPARQL Update, whose default graph is that resource's own.

    Raises Problems: 400 for what cannot be parsed, 422 for what reaches beyond the one graph (GRAPH, WITH, USING, LOAD,
    SERVICE, whole-graph operations).
    """
    try:
        text = data.decode("utf-8")
    except UnicodeDecodeError as error:
        raise Problem(400, f"The update is not UTF-8: {error.reason} at byte {error.start}.") from error
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
    return indexed(_as_spelt(store, said), base)


def _as_spelt(after: Iterable[Quad], before: Iterable[Triple]) -> Iterator[Quad]:
    """Quads of a store, with the literals that were there before spelt as they were: a store keeps values only, and
    01 is 1 to it."""
    spellings: dict[Literal, list[Literal]] = {}
    for literal, normal in _normal(each.object for each in before if isinstance(each.object, Literal)):
        spellings.setdefault(normal, []).append(literal)
    odd = {normal for normal, spelt in spellings.items() if spelt != [normal]}
    if not odd:
        yield from after
        return
    there = set(before)
    for quad in after:
        spelt = spellings[quad.object] if isinstance(quad.object, Literal) and quad.object in odd else ()
        known = [each for each in spelt if Triple(quad.subject, quad.predicate, each) in there]
        for each in known or (quad.object,):
            yield Quad(quad.subject, quad.predicate, each, quad.graph_name)


def _normal(literals: Iterable[Literal]) -> Iterator[tuple[Literal, Literal]]:
    """Each of these literals, and as what a store gives it back."""
    numbered = dict(enumerate(dict.fromkeys(literals)))
    store = Store()
    store.extend(Quad(NamedNode(f"urn:x-literal:{number}"), rdf.value, each) for number, each in numbered.items())
    for quad in store:
        if isinstance(quad.subject, NamedNode) and isinstance(quad.object, Literal):
            yield numbered[int(quad.subject.value.rpartition(":")[2])], quad.object
