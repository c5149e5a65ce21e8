"""The endpoints that a document describes, as a table: whose, on which topic, and with which quality of service."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

from pyoxigraph import BlankNode, Literal, NamedNode

from rosld.ontology.document import Document
from rosld.ontology.outline import Statements, outline
from rosld.ontology.vocab import rdf, ros
from rosld.server.html.labels import label
from rosld.server.html.site import Anchor, Site
from rosld.server.html.view import escape_controls

_MAX_ROWS = 200
_COLUMNS = ("Role", "Reliability", "Durability", "History", "More")
_TOLD = (ros.reliability, ros.durability)
_TIMES = (ros.deadline, ros.lifespan, ros.lease)
_PLAIN = "automatic"
"""The liveliness that all have who say nothing of it."""


@dataclass(frozen=True, slots=True)
class EndpointRow:
    """An endpoint: the other thing that it belongs to, and its cells; `wrong` says in words what is wrong with it."""

    anchor: Anchor
    cells: tuple[str, ...]
    problem: str = ""


@dataclass(frozen=True, slots=True)
class EndpointTable:
    """The endpoints of a topic, by node, or those of a node, by topic; `omitted` more are not shown."""

    heading: str
    columns: tuple[str, ...]
    rows: tuple[EndpointRow, ...]
    omitted: int = 0


def endpoint_table(document: Document, site: Site) -> EndpointTable | None:
    """The table of the endpoints of the document's resource, None where it tells of none."""
    subjects = outline(document.triples).subjects
    own = subjects.get(NamedNode(document.url), {})
    found = [each for each in own.get(ros.hasEndpoint, ()) if isinstance(each, NamedNode)]
    if not found:
        return None
    of_node = ros.Node in own.get(rdf.type, ())
    rows = [_row(each, subjects, ros.ofTopic if of_node else ros.ofNode, site) for each in found[:_MAX_ROWS]]
    told = [place for place in range(len(_COLUMNS)) if any(row.cells[place] for row in rows)]
    return EndpointTable(
        "Topic" if of_node else "Node",
        tuple(_COLUMNS[place] for place in told),
        tuple(replace(row, cells=tuple(row.cells[place] for place in told)) for row in rows),
        len(found) - len(rows),
    )


def _row(
    endpoint: NamedNode,
    subjects: dict[NamedNode | BlankNode, Statements],
    to: NamedNode,
    site: Site,
) -> EndpointRow:
    said = subjects.get(endpoint, {})
    qos: Statements = next(
        (subjects[each] for each in said.get(ros.hasQos, ()) if isinstance(each, NamedNode) and each in subjects), {}
    )
    other = next((each.value for each in said.get(to, ()) if isinstance(each, NamedNode)), endpoint.value)
    role = "publishes" if ros.Publisher in said.get(rdf.type, ()) else "subscribes"
    reliability, durability = (_first(qos, predicate) for predicate in _TOLD)
    history, depth = _first(qos, ros.history), _first(qos, ros.depth)
    conflicting = [each.value for each in said.get(ros.conflictingType, ()) if isinstance(each, NamedNode)]
    wrong = [_first(said, ros.unreachable), *(f"uses {site.short_name(each)}" for each in conflicting)]
    return EndpointRow(
        site.anchor(other) or Anchor("", escape_controls(other), other),
        (
            role,
            _space_out(reliability),
            _space_out(durability),
            " ".join(filter(None, (_space_out(history), depth))),
            ", ".join(_more(said, qos)),
        ),
        escape_controls("; ".join(filter(None, wrong))),
    )


def _more(said: Statements, qos: Statements) -> Iterable[str]:
    """What only some endpoints have to say."""
    if not qos and _first(said, ros.latched) == "true":
        yield "latched"
    for predicate in _TIMES:
        if seconds := _first(qos, predicate):
            yield f"{label(predicate.value)} {seconds} s"
    liveliness = _first(qos, ros.liveliness)
    if liveliness and liveliness != _PLAIN:
        yield f"liveliness {_space_out(liveliness)}"


def _first(statements: Statements, predicate: NamedNode) -> str:
    """The first literal of a predicate; empty where there is none."""
    return escape_controls(
        next((each.value for each in statements.get(predicate, ()) if isinstance(each, Literal)), "")
    )


def _space_out(word: str) -> str:
    return word.replace("_", " ")
