"""Receipts described: what somebody asked that would change something, and what became of it, in PROV-O."""

from __future__ import annotations

from typing import NamedTuple

from pyoxigraph import Literal, NamedNode

from rosld.ontology.document import Document
from rosld.ontology.triples import RDF_SOURCE, about, boolean, double, each, integer, moment, text
from rosld.ontology.urls import Space
from rosld.ontology.vocab import dcterms, htv, prov, rdf, rdfs, ros, xsd


class Receipt(NamedTuple):
    """What is remembered of one write. Receipts are ordered by their numbers; times are wall-clock nanoseconds.

    `agent` is what whoever asked is called, `webid` their URL if they have one. `url` is what was asked, `digest` that
    of the body (`sha-256=:...:`, RFC 9530), `excerpt` how the body begins; both are None where it has none, where it is
    no text, or where they are `withheld`. `plan` are the steps it came to, `touched` the URLs of what they are about,
    `matched` to how many subscribers messages went (None: none was published), `made` the URL of what was made.
    `words` say why it was refused.
    """

    number: int
    id: str
    agent: str
    webid: str | None
    started_ns: int
    ended_ns: int
    method: str
    url: str
    media_type: str | None
    length: int
    digest: str | None
    excerpt: str | None
    withheld: bool
    plan: tuple[str, ...]
    touched: tuple[str, ...]
    matched: int | None
    status: int
    made: str | None
    words: str | None

    @property
    def seconds(self) -> float:
        """How long the answer took."""
        return max(0, self.ended_ns - self.started_ns) / 1e9


def activity_document(receipt: Receipt, space: Space) -> Document:
    """A receipt: who asked what and when, the plan it came to, what that touched, what was answered."""
    url = space.activity(receipt.id)
    activity, agent = NamedNode(url), NamedNode(receipt.webid or agent_url(receipt.agent, space))
    request, answer, association, plan = (
        NamedNode(f"{url}#{name}") for name in ("request", "answer", "association", "plan")
    )
    has_plan = bool(receipt.plan)
    triples = about(
        activity,
        (rdf.type, ros.Write),
        (rdf.type, prov.Activity),
        *RDF_SOURCE,
        (prov.startedAtTime, moment(receipt.started_ns)),
        (prov.endedAtTime, moment(receipt.ended_ns)),
        (ros.duration, double(receipt.seconds)),
        (prov.wasAssociatedWith, agent),
        (prov.used, request),
        (prov.generated, answer),
        (prov.generated, NamedNode(receipt.made) if receipt.made else None),
        (prov.qualifiedAssociation, association if has_plan else None),
        *each(ros.touches, map(NamedNode, receipt.touched)),
        (ros.matched, integer(receipt.matched)),
    )
    triples += about(agent, (rdf.type, prov.Agent), (rdfs.label, text(receipt.agent)))
    triples += about(
        request,
        (rdf.type, htv.Request),
        (rdf.type, prov.Entity),
        (htv.methodName, Literal(receipt.method)),
        (htv.requestURI, Literal(receipt.url, datatype=xsd.anyURI)),
        (dcterms.format, text(receipt.media_type)),
        (ros.byteLength, integer(receipt.length) if receipt.length else None),
        (ros.digest, text(receipt.digest)),
        (ros.excerpt, text(receipt.excerpt)),
        (ros.withheld, boolean(True) if receipt.withheld else None),
    )
    triples += about(
        answer,
        (rdf.type, htv.Response),
        (rdf.type, prov.Entity),
        (htv.statusCodeValue, integer(receipt.status)),
        (ros.words, text(receipt.words)),
    )
    if has_plan:
        triples += about(association, (rdf.type, prov.Association), (prov.agent, agent), (prov.hadPlan, plan))
        steps = each(ros.does, [Literal(step) for step in dict.fromkeys(receipt.plan)])
        triples += about(plan, (rdf.type, prov.Plan), (rdf.type, prov.Entity), *steps)
    return Document(url, tuple(triples))


def agent_url(name: str, space: Space) -> str:
    """What stands for somebody who has no URL of their own: the same in all receipts."""
    return space.fragment(space.container("activity"), "agent", name)
