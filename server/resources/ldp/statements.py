"""Statements of bodies, merges and patches, in the form in which records store them. Pure.

Worker processes call the functions at the end, so this module has few imports.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from functools import cached_property
from typing import NamedTuple, TypeVar, overload

from pyoxigraph import BlankNode, NamedNode, RdfFormat, Triple, parse

from rosld.ontology.body import RdfBody, Term, index_triples, read_ntriples
from rosld.ontology.document import Document
from rosld.ontology.vocab import ldp
from rosld.server.dataset.base import TripleChanges
from rosld.server.http.problem import Problem
from rosld.server.patches.n3patch import apply_patch, find_changes, missing_deletion, read_patch
from rosld.server.patches.patch import apply_update, ground_changes, updated_lines
from rosld.server.rest.interaction import member_derived_uri
from rosld.server.storage.record import MAX_BYTES as DIFFERENT
from rosld.server.storage.record import Difference, Membership, Model, Record
from rosld.server.storage.record_documents import (
    client_ntriples,
    is_managed,
    is_packed,
    managed_triples,
    may_be_managed,
    pack_triples,
    parse_ntriples,
    remove_managed,
    to_ntriples,
    unpack_triples,
)

N3_PATCH = "text/n3"
SMALL_BYTES = 32 * 1024
"""Maximum size in bytes of a body parsed on the loop: at most some 15,000 triples, which take 15 ms."""
_TINY_BYTES = 4 * 1024
_LONG = re.compile(rb"""<[^>\s]{512}|"[^"]{512}|'[^']{512}|[^\s,;"'<>\[\](){}]{512}""")
"""Pattern of a long IRI, prefix or literal, which a body may state once and repeat in every triple."""
MAX_CHANGED = 500
"""Maximum number of triples in the recorded difference of a large document."""
MAX_PATCHED = 5_000
"""Maximum number of triples resulting from a patch on the loop; larger patches run in a worker process."""

_Term = TypeVar("_Term")


class Statements(Sequence[Triple]):
    """The triples of a body, given in packed form or as triples; each form is derived lazily from the other.

    `managed` are the server-managed triples about the resource, if known already; `changed` is the difference that a
    small change made to a large document.
    """

    def __init__(
        self, given: bytes | list[Triple], managed: Sequence[Triple] | None = None, changed: TripleChanges | None = None
    ) -> None:
        self._given = given
        self._managed = managed
        self.changed = changed

    @cached_property
    def packed(self) -> bytes:
        """The packed form that records store."""
        return self._given if isinstance(self._given, bytes) else pack_triples(to_ntriples(self._given))

    @property
    def is_large(self) -> bool:
        """Whether there are too many triples to process on the loop."""
        return isinstance(self._given, bytes) and is_packed(self._given)

    @property
    def managed(self) -> Sequence[Triple]:
        """The server-managed triples if known, else all triples if any may be server-managed."""
        if self._managed is not None:
            return self._managed
        return self if not isinstance(self._given, bytes) or may_be_managed(unpack_triples(self._given)) else ()

    def set_managed(self, managed: Sequence[Triple]) -> None:
        """Set the server-managed triples."""
        self._managed = managed

    def __reduce__(self) -> tuple[object, ...]:
        """Pickle without the parsed triples."""
        return Statements, (self.packed, self._managed, self.changed)

    def difference(self, before: Record, url: str, times: bytes) -> Difference | None:
        """Return the change of the record at `url`.

        None if it is unknown or large, or concerns blank nodes or server-managed triples.
        """
        if self.changed is None or before.model is not Model.RDF_SOURCE:
            return None
        triples = [*self.changed.removed, *self.changed.added]
        if any(_has_blank(each) for each in triples) or len(remove_managed(triples, url, before.model)) < len(triples):
            return None
        removed, added = map(to_ntriples, self.changed)
        return Difference(before, times, removed, added) if len(removed) + len(added) <= DIFFERENT else None

    @cached_property
    def _triples(self) -> list[Triple]:
        if not isinstance(self._given, bytes):
            return self._given
        return [quad.triple for quad in parse(unpack_triples(self._given), RdfFormat.N_TRIPLES)]

    @overload
    def __getitem__(self, index: int) -> Triple: ...
    @overload
    def __getitem__(self, index: slice) -> Sequence[Triple]: ...
    def __getitem__(self, index: int | slice) -> Triple | Sequence[Triple]:
        return self._triples[index]

    def __len__(self) -> int:
        return len(self._triples)

    def __iter__(self) -> Iterator[Triple]:
        return iter(self._triples)


NO_STATEMENTS = Statements(b"")


def is_small(data: bytes) -> bool:
    """Whether a body is small enough to be parsed in this process."""
    if len(data) <= _TINY_BYTES:
        return True
    return len(data) <= SMALL_BYTES and _LONG.search(data) is None


def statements_of(given: bytes | list[Triple]) -> Statements:
    """Return the statements of N-Triples or triples. Raises a 422 Problem for triples about triples."""
    if not isinstance(given, bytes):
        found = Statements(given)
    else:
        found = Statements(pack_triples(given))
        if b"<<" not in given:
            return found
    if any(Triple in (type(each.subject), type(each.object)) for each in found):
        raise Problem(422, "Triples about triples cannot be stored.")
    return found


def contained_members(triples: Iterable[Triple], url: str) -> set[Term]:
    """Return the members of the container at `url` by its containment triples."""
    subject = NamedNode(url)
    return {each.object for each in triples if each.predicate == ldp.contains and each.subject == subject}


def require_same_members(before: Iterable[Triple], after: Iterable[Triple], url: str) -> None:
    """Raise a 409 Problem if a patch would change what a container contains (LDP 5.2.4.1)."""
    if contained_members(before, url) != contained_members(after, url):
        raise Problem(409, f"{CONTAINMENT}, not by a patch.")


CONTAINMENT = "What a container contains (ldp:contains) is changed by POST and DELETE"


def triples_of(body: RdfBody) -> list[Triple]:
    """Return the triples of a body."""
    return [
        Triple(subject, predicate, each)
        for subject, properties in body.subjects.items()
        for predicate, objects in properties.items()
        for each in objects
    ]


def rename_blank_nodes(triples: Iterable[Triple]) -> list[Triple]:
    """Return the triples with new blank nodes, as merging graphs requires (RDF 1.1 Semantics 4.1)."""
    new: dict[BlankNode, BlankNode] = {}
    return [
        Triple(_anew(each.subject, new), each.predicate, _anew(each.object, new)) if _has_blank(each) else each
        for each in triples
    ]


def _has_blank(triple: Triple) -> bool:
    return isinstance(triple.subject, BlankNode) or isinstance(triple.object, BlankNode)


def _anew(term: _Term, new: dict[BlankNode, BlankNode]) -> _Term | BlankNode:
    return new.setdefault(term, BlankNode()) if isinstance(term, BlankNode) else term


def parse_patch(
    data: bytes, media_type: str, url: str, limit: int | None = None
) -> Callable[[Sequence[Triple]], list[Triple]]:
    """Return the function that applies a patch to triples, which raises TooManyTriples beyond `limit`.

    Raises Problems for an invalid patch.
    """
    if media_type == N3_PATCH:
        patch = read_patch(data, url)
        return lambda before: list(apply_patch(patch, before))
    return lambda before: triples_of(apply_update(data, before, url, limit))


# Called in worker processes


def parse_statements(ntriples: bytes, subject: str) -> Statements:
    """Return the statements of N-Triples, with the server-managed triples about the resource `subject`."""
    found, node = statements_of(ntriples), NamedNode(subject)
    may_be = found if may_be_managed(ntriples) else ()
    found.set_managed(
        tuple(each for each in may_be if each.subject == node and is_managed(each.predicate, each.object))
    )
    return found


def parse_body_statements(data: bytes, media_type: str, url: str, subject: str) -> Statements:
    """Return the statements of a body about `subject`, resolved against `url`. Raises BodyError and Problems."""
    return parse_statements(read_ntriples(data, media_type, url), subject)


def merge_statements(describe: Callable[[], Document], added: Statements, subject: str) -> Statements:
    """Return the statements of a document merged with the added ones."""
    before = describe().triples
    after = dict.fromkeys((*before, *rename_blank_nodes(added)))
    return _noting(before, after, parse_statements(to_ntriples(after), subject))


def patch_statements(
    describe: Callable[[], Document], data: bytes, media_type: str, url: str, subject: str
) -> Statements:
    """Return the statements of a document after a patch. Raises Problems."""
    before = describe().triples
    after = parse_patch(data, media_type, url)(before)
    require_same_members(before, after, url)
    return _noting(before, after, parse_statements(to_ntriples(after), subject))


def _noting(before: Sequence[Triple], after: Collection[Triple], found: Statements) -> Statements:
    """Set `changed` on the statements of a large document after a small change."""
    if found.is_large and abs(len(after) - len(before)) <= MAX_CHANGED:
        known = frozenset(before)
        added = [each for each in after if each not in known]
        removed: Collection[Triple] = ()
        if len(added) <= MAX_CHANGED and len(after) - len(added) < len(known):
            removed = known.difference(after)
        if len(added) + len(removed) <= MAX_CHANGED:
            found.changed = TripleChanges([*removed], added)
    return found


def client_triples(
    statements: Statements, subject: str, model: Model, servers: frozenset[Triple], times: bytes
) -> bytes:
    """Return the client's triples in packed form: neither server-managed nor in `servers`, preceded by `times`.

    `times` are the N-Triples of the times stated by the first writer.
    """
    return pack_triples(
        times + to_ntriples([each for each in remove_managed(statements, subject, model) if each not in servers])
    )


def member_uri(membership: Membership, statements: Statements, url: str) -> str:
    """Return the URI of a new member at `url` in membership triples. Raises like `member_derived_uri`."""
    return member_derived_uri(membership, index_triples(statements), url)


class KeptChange(NamedTuple):
    """The packed statements of a record after a change, and the lines that the change removed and added."""

    triples: bytes
    removed: bytes
    added: bytes


def change_statements(packed: bytes, removed: bytes, added: bytes) -> KeptChange | None:
    """Return the stored statements `packed` without the lines of `removed` and with those of `added`.

    None if lines of `removed` with blank nodes are missing: their labels may differ.
    """
    gone, new = dict.fromkeys(_lines(removed)), dict.fromkeys(_lines(added))
    lines = _lines(unpack_triples(packed))
    there = {*gone, *new}.intersection(lines)
    if has_blank_nodes(removed) and not there.issuperset(gone):
        return None
    lost = [line for line in gone if line in there and line not in new]
    come = [line for line in new if line not in there]
    if lost:
        without = frozenset(lost)
        lines = [line for line in lines if line not in without]
    return KeptChange(pack_triples(_text([*lines, *come])), _text(lost), _text(come))


def patch_record(
    record: Record, describe: Callable[[], Document], data: bytes, media_type: str, url: str, subject: str
) -> KeptChange | None:
    """Return the change that a SPARQL Update or N3 Patch makes, or None if it concerns server-managed triples.

    `describe` returns the whole document, which only patterns need. Raises Problems.
    """
    packed = record.triples
    if media_type == "text/n3":
        patch = read_patch(data, url)
        deletes, inserts = find_changes(patch, describe().triples if patch.where else ())
        if has_managed(deletes, subject) or has_managed(inserts, subject):
            return None
        removed, added = to_ntriples(deletes), to_ntriples(inserts)
        lacking = {*_lines(removed)}.difference(_lines(unpack_triples(packed)))
        if lacking:
            raise missing_deletion(next(each for each in deletes if str(each).encode() + b" ." in lacking))
        return change_statements(packed, removed, added)
    ground = ground_changes(data, url)
    if ground is not None:
        if has_managed(ground.removed, subject) or has_managed(ground.added, subject):
            return None
        return change_statements(packed, to_ntriples(ground.removed), to_ntriples(ground.added))
    if record.model.is_container:
        before = to_ntriples(describe().triples)
    else:
        before = to_ntriples(managed_triples(record, subject)) + client_ntriples(record, subject)
    removed, added = updated_lines(data, before, url)
    if any(may_be_managed(each) and has_managed(parse_ntriples(each), subject) for each in (removed, added)):
        return None
    return change_statements(packed, removed, added)


def has_managed(triples: Iterable[Triple], subject: str) -> bool:
    """Whether the server manages any of the triples."""
    node = NamedNode(subject)
    return any(each.subject == node and is_managed(each.predicate, each.object) for each in triples)


def has_blank_nodes(ntriples: bytes) -> bool:
    """Whether lines of N-Triples may contain blank nodes; some literals give a false positive."""
    return any(line.startswith(b"_:") or b" _:" in line[line.rindex(b" ", 0, -2) :] for line in _lines(ntriples))


def _lines(ntriples: bytes) -> list[bytes]:
    return ntriples.split(b"\n")[:-1]


def _text(lines: Sequence[bytes]) -> bytes:
    return b"\n".join([*lines, b""])
