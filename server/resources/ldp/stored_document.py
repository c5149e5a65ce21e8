"""The document of a record. Pure; worker processes import it, so it imports little."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from pyoxigraph import Triple

from rosld.ontology.document import Document
from rosld.server.rest.interaction import member_derived_uris, membership_declaration, membership_triples
from rosld.server.rest.paging import ContainerParts
from rosld.server.storage.record import Member, Record
from rosld.server.storage.record_documents import record_document, without_statements


def stored_document(
    base: str, record: Record, parts: ContainerParts, members: Sequence[Member], more: Sequence[Triple]
) -> Document:
    """The parts of a record, and of a container with these members, that are asked for; `more` is said beside them."""
    url = base + record.path
    membership = (
        membership_declaration(record.membership, url) if record.membership is not None and parts.minimal else []
    )
    if record.membership is not None and parts.membership:
        membership += membership_triples(record.membership, member_derived_uris_of(base, members))
    contained = [base + each.path for each in members] if parts.containment else []
    kept = record if parts.minimal else without_statements(record, url)
    return record_document(kept, url, contained, [*membership, *more])


def member_derived_uris_of(base: str, members: Iterable[Member]) -> list[str]:
    """What stands for members in the membership triples of their container (LDP 5.4.1.5, 5.5.1.2)."""
    return list(member_derived_uris((base + each.path, each.member) for each in members))
