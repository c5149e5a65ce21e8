"""What may be done with a resource now, in WoT's words: affordances, and a form for each way to do it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from pyoxigraph import Literal, NamedNode, Triple

from rosld.ontology.triples import Statement, text, triples_about
from rosld.ontology.vocab import hctl, htv, rdf, ros, td, xsd

BODIES = ("application/json", "text/turtle", "application/ld+json")
"""The media types in which a body can be sent."""
STREAM = ("text/event-stream",)
SSE: Statement = (hctl.forSubProtocol, Literal("sse"))
_ENDINGS: Mapping[str, str] = {"text/turtle": "-turtle", "application/ld+json": "-ld"}


def affordance(subject: NamedNode, name: str, relation: NamedNode, kind: NamedNode, *more: Statement) -> list[Triple]:
    """What may be done with the subject: its fragment `name`, led to by `relation`."""
    node = NamedNode(f"{subject.value}#{name}")
    return [Triple(subject, relation, node), *triples_about(node, (rdf.type, kind), (td.name, text(name)), *more)]


def forms(
    affordance: NamedNode,
    name: str,
    method: str,
    operation: NamedNode,
    target: str,
    media_types: Iterable[str] = (),
    *more: Statement,
    template: str | None = None,
) -> list[Triple]:
    """How an affordance is done: a form for each media type, for a form has one (WoT TD 1.1, 5.3.4.2).

    `template` is the target with its parameters (RFC 6570), which is no URI itself.
    """
    triples: list[Triple] = []
    for media_type in tuple(media_types) or (None,):
        form = NamedNode(f"{affordance.value}/{name}{_ENDINGS.get(media_type or '', '')}")
        triples += [
            Triple(affordance, td.hasForm, form),
            *triples_about(
                form,
                (rdf.type, hctl.Form),
                (hctl.hasOperationType, operation),
                (htv.methodName, Literal(method)),
                (hctl.hasTarget, Literal(target, datatype=xsd.anyURI)),
                (ros.uriTemplate, text(template)),
                (hctl.forContentType, text(media_type)),
                *more,
            ),
        ]
    return triples
