"""Changes of large documents, made to the N-Triples that are kept: what does not change is not parsed. Pure.

Kept are lines as the library writes triples, so that a triple is there if its line is. Worker processes call this.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import NamedTuple

from pyoxigraph import NamedNode, Triple

from rosld.ontology.document import Document
from rosld.server.patches.n3patch import find_changes, missing_deletion, read_patch
from rosld.server.patches.patch import ground_changes, updated_lines
from rosld.server.storage.record import Record
from rosld.server.storage.record_documents import (
    client_ntriples,
    is_managed,
    managed_triples,
    may_be_managed,
    pack_triples,
    parse_ntriples,
    to_ntriples,
    unpack_triples,
)


class KeptChange(NamedTuple):
    """The statements of a record after a change, as they are kept, and the lines that the change removed and added."""

    triples: bytes
    removed: bytes
    added: bytes


def change_kept(kept: bytes, removed: bytes, added: bytes) -> KeptChange | None:
    """The statements `kept` without the lines of `removed`, as far as they are there, and with those of `added`.

    None where blank nodes are removed that are not there: they may have other labels.
    """
    gone, new = dict.fromkeys(_lines(removed)), dict.fromkeys(_lines(added))
    lines = _lines(unpack_triples(kept))
    there = {*gone, *new}.intersection(lines)
    if has_blank_nodes(removed) and not there.issuperset(gone):
        return None
    lost = [line for line in gone if line in there and line not in new]
    come = [line for line in new if line not in there]
    if lost:
        without = frozenset(lost)
        lines = [line for line in lines if line not in without]
    return KeptChange(pack_triples(_text([*lines, *come])), _text(lost), _text(come))


def patch_kept(
    record: Record, describe: Callable[[], Document], data: bytes, media_type: str, url: str, subject: str
) -> KeptChange | None:
    """The change that a SPARQL Update or an N3 Patch makes; None where it is about what the server says of `subject`.

    `describe` makes the whole document, of which only patterns need more than the lines that are kept. Raises Problems.
    """
    kept = record.triples
    if media_type == "text/n3":
        patch = read_patch(data, url)
        deletes, inserts = find_changes(patch, describe().triples if patch.where else ())
        if has_managed(deletes, subject) or has_managed(inserts, subject):
            return None
        removed, added = to_ntriples(deletes), to_ntriples(inserts)
        lacking = {*_lines(removed)}.difference(_lines(unpack_triples(kept)))
        if lacking:
            raise missing_deletion(next(each for each in deletes if str(each).encode() + b" ." in lacking))
        return change_kept(kept, removed, added)
    ground = ground_changes(data, url)
    if ground is not None:
        if has_managed(ground.removed, subject) or has_managed(ground.added, subject):
            return None
        return change_kept(kept, to_ntriples(ground.removed), to_ntriples(ground.added))
    if record.model.is_container:
        before = to_ntriples(describe().triples)
    else:
        before = to_ntriples(managed_triples(record, subject)) + client_ntriples(record, subject)
    removed, added = updated_lines(data, before, url)
    if any(may_be_managed(each) and has_managed(parse_ntriples(each), subject) for each in (removed, added)):
        return None
    return change_kept(kept, removed, added)


def has_managed(triples: Iterable[Triple], subject: str) -> bool:
    """Whether the server manages any of the triples."""
    node = NamedNode(subject)
    return any(each.subject == node and is_managed(each.predicate, each.object) for each in triples)


def has_blank_nodes(ntriples: bytes) -> bool:
    """Whether a blank node stands in lines of N-Triples; also where a literal ends as such a line does."""
    return any(line.startswith(b"_:") or b" _:" in line[line.rindex(b" ", 0, -2) :] for line in _lines(ntriples))


def _lines(ntriples: bytes) -> list[bytes]:
    return ntriples.split(b"\n")[:-1]


def _text(lines: Sequence[bytes]) -> bytes:
    return b"\n".join([*lines, b""])
