"""Documents of receipts: requests for changes and their outcomes, in PROV-O."""

from __future__ import annotations

from typing import NamedTuple

from pyoxigraph import NamedNode, Triple

from rosld.ontology import kinds
from rosld.ontology.document import Document
from rosld.ontology.node_shape import SOURCE, NodeShape, many, one, optional
from rosld.ontology.observations import ACTUATOR
from rosld.ontology.triples import date_time_literal, text, triples_about
from rosld.ontology.urls import Space
from rosld.ontology.vocab import dcterms, htv, prov, rdf, rdfs, ros, sosa

_ACTIVITIES = frozenset({"calls", "goals", "holds"})
"""Containers whose members are activities: calls, goals, holds."""


class Receipt(NamedTuple):
    """Record of one write. Receipts are ordered by number; times are wall-clock nanoseconds.

    `agent` is the name of the agent, `webid` its URL, if any. `url` is the target, `digest` that of the body
    (`sha-256=:...:`, RFC 9530), `excerpt` the beginning of the body; both are None without a body, for a body that is
    not text, or if they are `withheld`. `plan` are the resulting steps, `touched` the URLs of their subjects, `matched`
    the number of subscribers (None if nothing was published), `made` the URL of a created resource. `words` are the
    reason for a refusal. `reason` is why the client made the request, and `client` the name of its program, both in its
    own words.
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
    reason: str | None = None
    client: str | None = None

    @property
    def seconds(self) -> float:
        """The duration of the response."""
        return max(0, self.ended_ns - self.started_ns) / 1e9


_WRITE = NodeShape[Receipt]("Write", "the receipt of a write", ros.Write, prov.Activity, *SOURCE).with_properties(
    one(rdfs.label, kinds.TEXT),
    one(prov.startedAtTime, kinds.DATE_TIME, lambda receipt: receipt.started_ns),
    one(prov.endedAtTime, kinds.DATE_TIME, lambda receipt: receipt.ended_ns),
    one(ros.duration, kinds.AMOUNT, lambda receipt: receipt.seconds),
    one(prov.wasAssociatedWith, kinds.IRI.where("sh:class prov:Agent")),
    one(prov.used, kinds.FRAGMENT.where("sh:class htv:Request"), lambda receipt: "#request"),
    many(prov.generated, kinds.FRAGMENT, lambda receipt: ["#answer"], minimum=1),
    optional(
        prov.qualifiedAssociation,
        kinds.FRAGMENT.where("sh:class prov:Association"),
        lambda receipt: "#association" if receipt.plan else None,
    ),
    many(ros.touches, kinds.IRI, lambda receipt: receipt.touched),
    optional(ros.matched, kinds.COUNT, lambda receipt: receipt.matched),
    optional(ros.reason, kinds.TEXT, lambda receipt: receipt.reason),
)
_REQUEST = NodeShape[Receipt]("Request", "what was asked", htv.Request, prov.Entity).with_properties(
    one(htv.methodName, kinds.TEXT, lambda receipt: receipt.method),
    one(htv.requestURI, kinds.URI, lambda receipt: receipt.url),
    optional(dcterms.format, kinds.TEXT, lambda receipt: receipt.media_type),
    optional(ros.byteLength, kinds.COUNT, lambda receipt: receipt.length or None),
    optional(ros.digest, kinds.TEXT, lambda receipt: receipt.digest),
    optional(ros.excerpt, kinds.TEXT, lambda receipt: receipt.excerpt),
    optional(ros.withheld, kinds.FLAG, lambda receipt: receipt.withheld or None),
    optional(prov.wasAttributedTo, kinds.IRI.where("sh:class prov:SoftwareAgent")),
)
_RESPONSE = NodeShape[Receipt]("Response", "what was answered", htv.Response, prov.Entity).with_properties(
    one(htv.statusCodeValue, kinds.COUNT.where("sh:maxInclusive 599"), lambda receipt: receipt.status),
    optional(ros.words, kinds.TEXT, lambda receipt: receipt.words),
)
_AGENT = NodeShape[Receipt]("Agent", "who asked", prov.Agent).with_properties(
    one(rdfs.label, kinds.TEXT, lambda receipt: receipt.agent)
)
_CLIENT = NodeShape[Receipt]("Client", "the program that sent a request", prov.SoftwareAgent).with_properties(
    one(rdfs.label, kinds.TEXT, lambda receipt: receipt.client)
)
_ASSOCIATION = NodeShape[NamedNode]("Association", "the association of an agent", prov.Association).with_properties(
    one(prov.agent, kinds.TERM.where("sh:class prov:Agent"), lambda agent: agent),
    one(prov.hadPlan, kinds.IRI.where("sh:class prov:Plan")),
)
_PLAN = NodeShape[Receipt]("Plan", "the plan of a write", prov.Plan, prov.Entity).with_properties(
    many(ros.does, kinds.TEXT, lambda receipt: dict.fromkeys(receipt.plan), minimum=1)
)


def activity_document(receipt: Receipt, space: Space) -> Document:
    """Return a receipt: agent, request, time, plan, touched resources, and response."""
    url = space.activity(receipt.id)
    activity, agent = NamedNode(url), NamedNode(receipt.webid or agent_url(receipt.agent, space))
    request, answer, association, plan = (
        NamedNode(f"{url}#{name}") for name in ("request", "answer", "association", "plan")
    )
    made = NamedNode(receipt.made) if receipt.made else None
    is_activity = _is_activity(receipt.made, space)
    generated = None if is_activity else made
    label = (rdfs.label, text(f"{receipt.method} {receipt.url.removeprefix(space.base[:-1])}"))
    more = (prov.wasAssociatedWith, agent), (prov.generated, generated)
    triples = _WRITE.triples(activity, receipt, space, label, *more)
    if made and is_activity:
        triples.append(Triple(made, prov.wasInformedBy, activity))
    triples += _AGENT.triples(agent, receipt, space)
    client = NamedNode(f"{url}#client") if receipt.client else None
    triples += _REQUEST.triples(request, receipt, space, (prov.wasAttributedTo, client))
    if client is not None:
        triples += _CLIENT.triples(client, receipt, space)
    triples += _RESPONSE.triples(answer, receipt, space)
    if receipt.plan:
        triples += _ASSOCIATION.triples(association, agent, space, (prov.hadPlan, plan))
        triples += _PLAN.triples(plan, receipt, space)
    triples += _actuations(receipt, activity, space)
    return Document(url, tuple(triples))


def _is_activity(url: str | None, space: Space) -> bool:
    """Whether the result of a write is an activity itself: in PROV, activities are not generated."""
    return _kind_of(url, space) in _ACTIVITIES


def _kind_of(url: str | None, space: Space) -> str | None:
    location = None if url is None else space.location(url)
    return None if location is None else location.kind


def _actuations(receipt: Receipt, activity: NamedNode, space: Space) -> list[Triple]:
    """Return what was published, or is held, as actuations: one for each topic."""
    published = receipt.matched is not None or _kind_of(receipt.made, space) == "holds"
    topics = [url for url in receipt.touched if published and _kind_of(url, space) == "topics"]
    return [
        triple
        for number, url in enumerate(topics, 1)
        for triple in triples_about(
            NamedNode(f"{activity.value}#actuation{number if number > 1 else ''}"),
            (rdf.type, sosa.Actuation),
            (sosa.madeByActuator, NamedNode(url + ACTUATOR)),
            (sosa.hasFeatureOfInterest, NamedNode(f"{space.base}#robot")),
            (sosa.resultTime, date_time_literal(receipt.ended_ns)),
            (sosa.hasSimpleResult, text(receipt.excerpt)),
            (prov.wasInformedBy, activity),
        )
    ]


def agent_url(name: str, space: Space) -> str:
    """Return the URL of an agent, or the placeholder IRI for agents without one."""
    return space.fragment(space.container("activity"), "agent", name)
