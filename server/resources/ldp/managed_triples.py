"""Server-managed triples in bodies: accepted where they state what is so, else 409 (LDP 4.2.4.3). Pure."""

from __future__ import annotations

from collections.abc import Sequence

from pyoxigraph import Literal, NamedNode, Triple

from rosld.ontology.literals import date_time_nanoseconds
from rosld.ontology.vocab import dcterms, ldp, rdf
from rosld.server.http.problem import Problem
from rosld.server.rest.interaction import membership_declaration
from rosld.server.storage.record import Membership, Model, Record, rdf_types
from rosld.server.storage.record_documents import (
    MAX_TIME_BYTES,
    MEMBERSHIP,
    TIMES,
    client_times,
    is_managed,
    managed_triples,
    parse_ntriples,
    to_ntriples,
)

_MILLISECOND = 1_000_000
"""Nanoseconds: many clients know times no better, JavaScript's do not."""


def managed_triples_in(triples: Sequence[Triple], url: str, model: Model) -> list[Triple]:
    """Return the server-managed triples in a body about the resource at `url`."""
    if not triples:
        return []
    subject = NamedNode(url)
    return [each for each in triples if each.subject == subject and is_managed(each.predicate, each.object, model)]


# Of what is new


def initial_times(managed: Sequence[Triple]) -> bytes:
    """When a new resource was created and modified as its first writer says, as lines of N-Triples.

    Raises a 409 Problem for what is said more than once, or by something else than a short literal.
    """
    found: list[Triple] = []
    for predicate in TIMES:
        said = list(dict.fromkeys(each for each in managed if each.predicate == predicate))
        if len(said) > 1 or not all(isinstance(each.object, Literal) for each in said):
            raise Problem(409, f"{predicate.value} of a resource is one literal, such as a date.")
        if said and len(str(said[0].object).encode()) > MAX_TIME_BYTES - 100:
            raise Problem(409, f"{predicate.value} is longer than any date: say it shorter.")
        found += said
    return to_ntriples(found)


def require_classes(managed: Sequence[Triple], model: Model) -> None:
    """Raise a 409 Problem where a body says that it is of another interaction model than it is to be made with."""
    for each in managed:
        if each.predicate == rdf.type and each.object not in rdf_types(model):
            asked = each.object.value if isinstance(each.object, NamedNode) else each.object
            words = f"{rdf.type.value} {asked} does not fit: this is to be an ldp:{model.value}. Ask for another"
            raise Problem(409, f'{words} interaction model by a Link header with rel="type" (LDP 5.2.3.4).')


# Of what is there


def require_unchanged(managed: Sequence[Triple], record: Record, url: str) -> None:
    """Raise a 409 Problem, which names the property, where a body says otherwise what the server says of a resource.

    A time of modification that it had at any time since it was made passes: it is an earlier state that is put back.
    Members and membership are judged by themselves.
    """
    present, first = managed_triples(record, url), parse_ntriples(b"".join(client_times(record, url)))
    for each in managed:
        if each.predicate == ldp.contains or each.predicate in MEMBERSHIP or each in present or each in first:
            continue
        now = [one.object for one in present if one.predicate == each.predicate]
        if each.predicate in TIMES and _is_a_time_of(each, now, record):
            continue
        raise _refusal(each, now)


def require_membership(membership: Membership, managed: Sequence[Triple], url: str) -> None:
    """Raise a 409 Problem, which names the property, where a body changes what membership triples are made of."""
    present = membership_declaration(membership, url)
    for each in managed:
        is_default = each.predicate == ldp.insertedContentRelation and membership.content is None
        if each.predicate not in MEMBERSHIP or each in present or (is_default and each.object == ldp.MemberSubject):
            continue
        raise _refusal(each, [one.object for one in present if one.predicate == each.predicate])


def _is_a_time_of(said: Triple, now: Sequence[object], record: Record) -> bool:
    at = _milliseconds(said.object)
    if at is None:
        return False
    if said.predicate == dcterms.modified and record.created_ns // _MILLISECOND <= at:
        return at <= record.modified_ns // _MILLISECOND
    return at in map(_milliseconds, now)


def _milliseconds(value: object) -> int | None:
    at = date_time_nanoseconds(value.value) if isinstance(value, Literal) else None
    return None if at is None else at // _MILLISECOND


def _refusal(said: Triple, now: Sequence[object]) -> Problem:
    is_so = f"is {' and '.join(map(str, now))} here" if now else "is not said here"
    return Problem(409, f"{said.predicate.value} {is_so}, and not a client's to change: leave {said.object} away.")
