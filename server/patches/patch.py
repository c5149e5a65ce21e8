"""PATCH of one resource: JSON merge patch (RFC 7396) and SPARQL Update. No I/O."""

from __future__ import annotations

from collections.abc import Iterable

from pyoxigraph import DefaultGraph, NamedNode, Quad, RdfFormat, Store, Triple, parse

from rosld.ontology.body import RdfBody, index_quads
from rosld.server.dataset.base import Function, TripleChanges
from rosld.server.dataset.encoding import decode_ntriples, decode_triple, encode_ntriples, encode_triple
from rosld.server.dataset.private_functions import FUNCTIONS
from rosld.server.http.problem import Problem
from rosld.server.sparql.syntax.lexer import check_update_of_one_graph, tokens
from rosld.server.sparql.update.operations import ChangeData
from rosld.server.sparql.update.parser import read_checked, rewrite_update


def merge_patch(target: object, patch: object) -> object:
    """Return `target` changed by `patch` (RFC 7396 2): null removes, objects are merged, all else replaces."""
    if not isinstance(patch, dict):
        return patch
    merged = dict(target) if isinstance(target, dict) else {}
    for name, value in patch.items():
        if value is None:
            merged.pop(name, None)
        else:
            merged[name] = merge_patch(merged.get(name), value)
    return merged


class TooManyTriples(Exception):
    """A patch whose result has too many triples."""


def apply_update(
    data: bytes, before: Iterable[Triple], base: str, limit: int | None = None, *, by_value: bool = False
) -> RdfBody:
    """Return the triples of one resource after a SPARQL Update, whose default graph is that resource's own.

    `by_value`: literals of equal value are equal, for a robot's data, which has values but no spelling, and which some
    clients write in another form (rdflib.js writes `false` as "0"). The result then has the store's spelling. Otherwise
    literals must be identical.

    Raises Problems: 400 for invalid syntax, 422 for an update that uses more than the one graph (GRAPH, WITH, USING,
    LOAD, SERVICE, whole-graph operations). Raises TooManyTriples if the result exceeds `limit`.
    """
    checked = check_update_of_one_graph(_text(data))
    rewritten = rewrite_update(checked, base)
    store = Store()
    store.extend(map(_in_store, before if by_value else map(encode_triple, before)))
    _carry_out(store, checked.text if by_value else rewritten, base, None if by_value else _FUNCTIONS)
    if limit is not None and len(store) > limit:
        raise TooManyTriples
    return index_quads(store if by_value else map(_decoded, store), base)


def ground_changes(data: bytes, base: str) -> TripleChanges | None:
    """Return the net change of an update of one graph with only INSERT DATA and DELETE DATA; None for other updates.

    Raises Problems like `apply_update`.
    """
    checked = check_update_of_one_graph(_text(data))
    removed: dict[Triple, None] = {}
    added: dict[Triple, None] = {}
    for operation in read_checked(checked, base):
        if not isinstance(operation, ChangeData):
            return None
        for quad in operation.deletes:
            added.pop(quad.triple, None)
            removed[quad.triple] = None
        for quad in operation.inserts:
            removed.pop(quad.triple, None)
            added[quad.triple] = None
    return TripleChanges((*removed,), (*added,))


def updated_lines(data: bytes, before: bytes, base: str) -> tuple[bytes, bytes]:
    """Return the lines of N-Triples that an update of one graph removes and adds.

    Raises Problems like `apply_update`.
    """
    text = rewrite_update(check_update_of_one_graph(_text(data)), base)
    store = Store()
    stored = encode_ntriples(before.decode()).encode()
    if b"_:" in stored:  # the store would rename blank nodes
        store.bulk_extend(parse(stored, RdfFormat.N_TRIPLES))
    else:
        store.bulk_load(stored, RdfFormat.N_TRIPLES)
    _carry_out(store, text, base, _FUNCTIONS)
    held = store.dump(format=RdfFormat.N_TRIPLES, from_graph=DefaultGraph()) or b""
    old, new = ({*lines.split(b"\n")} for lines in (before, decode_ntriples(held)))
    return _join_lines(old - new), _join_lines(sorted(new - old))


def _join_lines(lines: Iterable[bytes]) -> bytes:
    return b"".join(line + b"\n" for line in lines)


def _carry_out(store: Store, text: str, base: str, functions: dict[NamedNode, Function] | None) -> None:
    try:
        store.update(text, base_iri=base, custom_functions=functions)
    except SyntaxError as error:
        raise Problem(400, "The update cannot be parsed.") from error
    except (OSError, RuntimeError, ValueError) as error:
        raise Problem(422, f"The update cannot be applied: {error}.") from error


def _decoded(quad: Quad) -> Quad:
    triple = quad.triple
    decoded = decode_triple(triple)
    return quad if decoded is triple else _in_store(decoded)


def _in_store(triple: Triple) -> Quad:
    return Quad(triple.subject, triple.predicate, triple.object)


_FUNCTIONS: dict[NamedNode, Function] = {NamedNode(name): function for name, function in FUNCTIONS.items()}


def has_deletes(update: bytes) -> bool:
    """Whether a SPARQL Update has an operation that deletes. Raises a 400 Problem if it is not UTF-8."""
    return any(token.is_word("DELETE") for token in tokens(_text(update)))


def _text(update: bytes) -> str:
    try:
        return update.decode("utf-8")
    except UnicodeDecodeError as error:
        raise Problem(400, f"The update is not UTF-8: {error.reason} at byte {error.start}.") from error
