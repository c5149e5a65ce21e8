"""Documents of records (LDP 4.2, 5.2), and the compression of large N-Triples. No I/O.

A million similar triples are some hundred megabytes of N-Triples, and three megabytes compressed. Small ones are stored
as they are. Compressing large ones takes about a second, which is left to worker processes.
"""

from __future__ import annotations

import re
import struct
import zlib
from collections.abc import Iterable, Sequence
from typing import NamedTuple

from msgspec.structs import replace
from pyoxigraph import NamedNode, RdfFormat, Triple, parse

from rosld.ontology.document import Document
from rosld.ontology.triples import Statement, date_time_literal, integer, statements, text, triples_about
from rosld.ontology.vocab import dcterms, ldp, rdf, ros
from rosld.server.storage.record import Model, Record, rdf_types

LARGE_BYTES = 256 * 1024
"""Minimum bytes of N-Triples that are compressed: some 2,500 triples, which take 5 ms to parse."""
MAX_BYTES = 2 * 1024 * 1024 * 1024
"""Maximum bytes of N-Triples that can be compressed."""
_MARK = b"\x00z1"
"""First bytes of compressed N-Triples; plain N-Triples never begin with them."""
_HEAD = struct.Struct("<3sQ")
_LEVEL = 1
"""The fastest level is enough: lines of N-Triples are very similar."""


def pack_triples(ntriples: bytes) -> bytes:
    """Return N-Triples as stored: compressed if they are large."""
    if len(ntriples) < LARGE_BYTES:
        return ntriples
    return _HEAD.pack(_MARK, len(ntriples)) + zlib.compress(ntriples, _LEVEL)


def unpack_triples(stored: bytes) -> bytes:
    """Return the plain form of N-Triples, compressed or not."""
    return (
        zlib.decompress(memoryview(stored)[_HEAD.size :], bufsize=unpacked_size(stored))
        if is_packed(stored)
        else stored
    )


def unpack_prefix(stored: bytes, size: int) -> bytes:
    """Return the first `size` bytes of the N-Triples, without decompressing the rest."""
    if not is_packed(stored):
        return stored[:size]
    return zlib.decompressobj().decompress(memoryview(stored)[_HEAD.size :], size)


def is_packed(stored: bytes) -> bool:
    """Whether N-Triples are compressed."""
    return stored[: len(_MARK)] == _MARK


def unpacked_size(stored: bytes) -> int:
    """Return the size in bytes of the plain N-Triples."""
    return int(_HEAD.unpack_from(stored)[1]) if is_packed(stored) else len(stored)


def is_large(record: Record) -> bool:
    """Whether the triples of a record are too large for the event loop."""
    return is_packed(record.triples) or len(record.triples) >= LARGE_BYTES


MEMBERSHIP = frozenset(
    {ldp.membershipResource, ldp.hasMemberRelation, ldp.isMemberOfRelation, ldp.insertedContentRelation}
)
"""Predicates that configure membership triples (LDP 5.2.1): stated by the client on creation, then by the server."""
TIMES = (dcterms.created, dcterms.modified)
_SPELT_TIMES = tuple(f"{predicate} ".encode() for predicate in TIMES)
FILE_PROPERTIES = frozenset({dcterms.format, ros.byteLength})
"""Server-managed properties of the bytes of a non-RDF source."""
META = ".meta"
"""Suffix of the URL of a non-RDF source's description."""
MAX_TIME_BYTES = 1000
"""Maximum bytes, without the URL, of the line that states when a resource was created or modified."""


def record_document(record: Record, url: str, members: Sequence[str], membership: Sequence[Triple]) -> Document:
    """Return the document of the resource at `url`, with the URLs of its `members` and its `membership` triples.

    For a non-RDF source it is the description, at its URL and `.meta`.
    """
    document = url + META if record.model is Model.NON_RDF_SOURCE else url
    contained = triples_about(NamedNode(url), *statements(ldp.contains, map(NamedNode, members))) if members else ()
    times = client_times(record, url)
    stated = parse_ntriples(_without_times(times, record))
    return Document(document, (*_managed(record, url, times), *contained, *stated, *membership))


def managed_triples(record: Record, url: str) -> tuple[Triple, ...]:
    """Return the server-managed triples of a resource without members and membership: classes, times, size.

    Times are those that its first writer stated, if any; the modification time only until the next write.
    """
    return _managed(record, url, client_times(record, url))


def _managed(record: Record, url: str, stated: ClientTimes) -> tuple[Triple, ...]:
    times = stated.created + (stated.modified if _is_new(record) else b"")
    created = () if stated.created else ((dcterms.created, date_time_literal(record.created_ns)),)
    modified = (
        () if stated.modified and _is_new(record) else ((dcterms.modified, date_time_literal(record.modified_ns)),)
    )
    classes = ((rdf.type, each) for each in rdf_types(record.model))
    return (*triples_about(NamedNode(url), *classes, *created, *modified, *_of_file(record)), *parse_ntriples(times))


def _is_new(record: Record) -> bool:
    return record.created_ns == record.modified_ns


class ClientTimes(NamedTuple):
    """Creation and modification time stated by a resource's first writer: lines of N-Triples, empty if not stated.

    The triples of a record begin with these lines.
    """

    created: bytes
    modified: bytes


_NOT_STATED = ClientTimes(b"", b"")


def client_times(record: Record, url: str) -> ClientTimes:
    """Return the times that the first writer of a record stated."""
    left = unpack_prefix(record.triples, len(TIMES) * (len(url) + MAX_TIME_BYTES))
    subject, lines = f"<{url}> ".encode(), []
    if not left.startswith(subject):
        return _NOT_STATED
    for predicate in _SPELT_TIMES:
        is_stated = left.startswith(subject + predicate)
        line, left = (left[: left.index(b"\n") + 1], left[left.index(b"\n") + 1 :]) if is_stated else (b"", left)
        lines.append(line)
    return ClientTimes(*lines)


def client_ntriples(record: Record, url: str) -> bytes:
    """Return the client's statements about a resource, without its times, as N-Triples."""
    return _without_times(client_times(record, url), record)


def _without_times(times: ClientTimes, record: Record) -> bytes:
    return unpack_triples(record.triples)[sum(map(len, times)) :]


def without_statements(record: Record, url: str) -> Record:
    """Return a record without client statements except its times."""
    return replace(record, triples=b"".join(client_times(record, url)))


def parse_ntriples(ntriples: bytes) -> tuple[Triple, ...]:
    """Return the distinct triples, with literals in their original spelling."""
    quads = parse(ntriples, RdfFormat.N_TRIPLES) if ntriples else ()
    return tuple(dict.fromkeys(quad.triple for quad in quads))


def _of_file(record: Record) -> Iterable[Statement]:
    if record.blob is None:
        return ()
    return ((dcterms.format, text(record.blob.media_type)), (ros.byteLength, integer(record.blob.size)))


def remove_managed(triples: Iterable[Triple], url: str, model: Model) -> list[Triple]:
    """Return the triples without those about `url` that the server manages."""
    subject = NamedNode(url)
    return [each for each in triples if each.subject != subject or not is_managed(each.predicate, each.object, model)]


def is_managed(predicate: NamedNode, value: object, model: Model | None = None) -> bool:
    """Whether the server manages triples with this predicate, for a resource of this model (None: of any model)."""
    if predicate == rdf.type:
        return value in _CLASSES
    if predicate in FILE_PROPERTIES:
        return model in (None, Model.NON_RDF_SOURCE)
    if predicate in MEMBERSHIP:
        return model in (None, Model.DIRECT_CONTAINER, Model.INDIRECT_CONTAINER)
    return predicate in TIMES or predicate == ldp.contains


_CLASSES = frozenset(each for model in Model for each in rdf_types(model))
_SIGNS = (f"<{ldp.iri}", *map(str, TIMES), *map(str, FILE_PROPERTIES))
_SIGN = re.compile("|".join(map(re.escape, _SIGNS)).encode())


def may_be_managed(ntriples: bytes) -> bool:
    """Whether the output of `to_ntriples` may contain server-managed triples. Has false positives."""
    return _SIGN.search(ntriples) is not None


def to_ntriples(triples: Iterable[Triple]) -> bytes:
    """Return triples as stored N-Triples, not compressed."""
    return "".join([f"{triple} .\n" for triple in triples]).encode()
