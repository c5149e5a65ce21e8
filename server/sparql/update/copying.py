"""The triples that COPY, MOVE and ADD take from a graph: those of its clients, without the server-managed ones."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from pyoxigraph import NamedNode, Triple

from rosld.ontology.vocab import ldp, rdf
from rosld.server.storage.record import Model, rdf_types
from rosld.server.storage.record_documents import META, remove_managed


def unmanaged_triples(graph: str, triples: Sequence[Triple]) -> list[Triple]:
    """Return the triples of a graph without those that the server manages for its resource (LDP 4.2.4.3).

    In another graph these would be wrong: they state when the source was created, and what it contains.
    """
    subject = NamedNode(graph.removesuffix(META))
    own = [each for each in triples if each.subject == subject]
    membership = set(_membership_triples(own, triples))
    return [each for each in remove_managed(triples, subject.value, _model(own)) if each not in membership]


def _model(own: Sequence[Triple]) -> Model:
    """Return the interaction model of a resource by its stated classes; an RDF source if they determine none."""
    classes = {each.object for each in own if each.predicate == rdf.type}
    fitting = [model for model in Model if classes >= set(rdf_types(model))]
    return max(fitting, key=lambda model: len(rdf_types(model)), default=Model.RDF_SOURCE)


def _membership_triples(own: Sequence[Triple], triples: Sequence[Triple]) -> Iterator[Triple]:
    """Yield the membership triples of a Direct or an Indirect container (LDP 5.2.1.4)."""
    properties = {each.predicate: each.object for each in own}
    constant = properties.get(ldp.membershipResource)
    content = properties.get(ldp.insertedContentRelation, ldp.MemberSubject)
    members = None  # the members of an Indirect container are unknown here: any object may be one
    if content == ldp.MemberSubject:
        members = {each.object for each in own if each.predicate == ldp.contains}
    for each in triples:
        if each.predicate == properties.get(ldp.hasMemberRelation) and each.subject == constant:
            member = each.object
        elif each.predicate == properties.get(ldp.isMemberOfRelation) and each.object == constant:
            member = each.subject
        else:
            continue
        if members is None or member in members:
            yield each
