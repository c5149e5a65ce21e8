"""Records described: what a client said of a resource, and what the server adds to it (LDP 4.2, 5.2). Pure."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence

from pyoxigraph import NamedNode, RdfFormat, Triple, parse

from rosld.ontology.document import Document
from rosld.ontology.triples import Statement, about, each, integer, moment, text
from rosld.ontology.vocab import dcterms, ldp, rdf, ros
from rosld.server.ldp.interaction import rdf_types
from rosld.server.records.packing import unpack
from rosld.server.records.record import Model, Record

MANAGED = frozenset({ldp.contains, dcterms.created, dcterms.modified, ros.length, dcterms.format})
"""What the server says of a resource, and nobody else."""
MEMBERSHIP = frozenset(
    {ldp.membershipResource, ldp.hasMemberRelation, ldp.isMemberOfRelation, ldp.insertedContentRelation}
)
"""What a container says its membership triples are made of: a client says it once, the server from then on."""
META = ".meta"
"""What the URL of a non-RDF source's description ends in."""


def record_document(record: Record, url: str, members: Sequence[str], membership: Sequence[Triple]) -> Document:
    """What the resource at `url` says: `members` are the URLs of what it contains, `membership` its own triples.

    Of a non-RDF source it is the description, at its URL and `.meta`.
    """
    subject = NamedNode(url)
    document = url + META if record.model is Model.NON_RDF_SOURCE else url
    managed = about(
        subject,
        *((rdf.type, kind) for kind in rdf_types(record.model)),
        (dcterms.created, moment(record.created_ns)),
        (dcterms.modified, moment(record.modified_ns)),
        *_of_file(record),
        *each(ldp.contains, map(NamedNode, members)),
    )
    return Document(document, (*managed, *said(record), *membership))


def said(record: Record) -> tuple[Triple, ...]:
    """What clients say of a resource, spelt as they did."""
    quads = parse(unpack(record.triples), RdfFormat.N_TRIPLES) if record.triples else ()
    return tuple(dict.fromkeys(quad.triple for quad in quads))


def _of_file(record: Record) -> Iterable[Statement]:
    if record.blob is None:
        return ()
    return ((dcterms.format, text(record.blob.media_type)), (ros.length, integer(record.blob.size)))


def unmanaged(triples: Iterable[Triple], url: str) -> list[Triple]:
    """The triples that are not the server's to say: neither the kind, the times nor the members of what is at `url`."""
    subject = NamedNode(url)
    return [each for each in triples if each.subject != subject or not is_managed(each.predicate, each.object)]


def is_managed(predicate: NamedNode, value: object) -> bool:
    """Whether what is said of a resource by a predicate is the server's to say."""
    if predicate == rdf.type:
        return isinstance(value, NamedNode) and value.value.startswith(ldp.iri)
    return predicate in _OURS


_OURS = MANAGED | MEMBERSHIP
_SIGNS = (f"<{ldp.iri}", *(str(each) for each in _OURS if not each.value.startswith(ldp.iri)))
_SIGN = re.compile("|".join(map(re.escape, _SIGNS)).encode())


def may_be_managed(ntriples: bytes) -> bool:
    """Whether `unmanaged` may leave anything out of N-Triples as `written`: told from their bytes, on the safe side."""
    return _SIGN.search(ntriples) is not None


def written(triples: Iterable[Triple]) -> bytes:
    """Triples as they are kept."""
    return "".join([f"{triple} .\n" for triple in triples]).encode()
