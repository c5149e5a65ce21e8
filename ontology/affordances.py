"""What may be done with a resource now, in WoT's words: affordances, and a form for each way to do it."""

from __future__ import annotations

from pyoxigraph import Literal, NamedNode, Triple

from rosld.ontology.triples import Statement, about, text
from rosld.ontology.vocab import hctl, htv, rdf, td, xsd


def affordance(subject: NamedNode, name: str, relation: NamedNode, kind: NamedNode, *more: Statement) -> list[Triple]:
    """What may be done with the subject: its fragment `name`, led to by `relation`."""
    node = NamedNode(f"{subject.value}#{name}")
    return [Triple(subject, relation, node), *about(node, (rdf.type, kind), (td.name, text(name)), *more)]


def form(
    subject: NamedNode,
    affordance: str,
    name: str,
    method: str,
    operation: NamedNode,
    *more: Statement,
    target: str | None = None,
) -> list[Triple]:
    """How an affordance of the subject is done; a target with parameters is a URI template (RFC 6570)."""
    node = NamedNode(f"{subject.value}#{affordance}")
    form = NamedNode(f"{node.value}/{name}")
    return [
        Triple(node, td.hasForm, form),
        *about(
            form,
            (rdf.type, hctl.Form),
            (hctl.hasOperationType, operation),
            (htv.methodName, Literal(method)),
            (hctl.hasTarget, subject if target is None else Literal(target, datatype=xsd.anyURI)),
            *more,
        ),
    ]
