"""PATCH: JSON merge patch (RFC 7396) and SPARQL Update on one resource. Pure."""

from __future__ import annotations

from collections.abc import Iterable

from pyoxigraph import Quad, Store, Triple

from rosld.ontology.body import RdfBody, indexed
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
    store.extend(Quad(triple.subject, triple.predicate, triple.object) for triple in before)
    try:
        store.update(text, base_iri=base)
    except SyntaxError as error:
        raise Problem(400, f"The update cannot be parsed: {error}.") from error
    except (OSError, RuntimeError, ValueError) as error:
        raise Problem(422, f"The update cannot be carried out: {error}.") from error
    return indexed(store, base)
