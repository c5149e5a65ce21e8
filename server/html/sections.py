"""Sections of pages: messages, endpoints, and the steps of a stop."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

from msgspec import Struct
from msgspec.structs import replace
from pyoxigraph import BlankNode, Literal, NamedNode

from rosld.ontology.document import Document, LiftedMessage
from rosld.ontology.outline import Statements, outline
from rosld.ontology.vocab import rdf, rdfs, ros
from rosld.server.html.graphics import PictureView, picture_view, plot_prefix, topic_view
from rosld.server.html.labels import capitalize, label
from rosld.server.html.messages import message_view
from rosld.server.html.page import Term
from rosld.server.html.site import Anchor, Site
from rosld.server.html.values import iri_view
from rosld.server.html.view import TableView, View, escape_controls, time_view
from rosld.server.space.point_cloud import POINT_CLOUD

_TITLES = {ros.latest: "Latest message", ros.recordedMessage: "Message", ros.heldMessage: "Message"}
_DRAWN = frozenset({ros.latest, ros.recordedMessage})
"""Predicates that link a resource to a message which can be drawn as a picture."""
NEWEST = "#message"


class MessageSection(Struct, frozen=True):
    """A message on a page: its fragment, its metadata, and its fields."""

    id: str
    title: str
    type: Anchor | None
    body: TableView
    received: View | None = None
    sequence: int | None = None
    publisher: View | None = None
    aside: bool = False
    picture: PictureView | None = None
    space: str = ""
    """URL of its view in space, or empty."""
    is_cloud: bool = False
    """Whether it is a point cloud."""


def message_sections(document: Document, site: Site, query: str = "") -> tuple[MessageSection, ...]:
    """Return the sections of a document's messages; those of single publishers are folded if there are several.

    `query` is the query string of the page's URL.
    """
    roles = _roles(document)
    return tuple(
        _section(document, site, each, roles.get(each.node, ros.recordedMessage), query) for each in document.messages
    )


def _roles(document: Document) -> Mapping[str, NamedNode]:
    """Return the predicate that links each message to its document."""
    prefix = f"{document.url}#"
    return {
        triple.object.value[len(prefix) - 1 :]: triple.predicate
        for triple in document.triples
        if isinstance(triple.object, NamedNode) and triple.object.value.startswith(prefix)
    }


def _section(document: Document, site: Site, each: LiftedMessage, role: NamedNode, query: str) -> MessageSection:
    schema = each.lifter.schema
    picture = picture_view(schema, each.message, query, moves=role == ros.latest) if role in _DRAWN else None
    body = message_view(
        schema,
        each.message,
        simulated_time=document.simulated_time,
        octets="?field=" if each.node == NEWEST else None,
        has_heads=picture is None or bool(picture.refused),
        plots=plot_prefix(document.url, site) if each.node == NEWEST else None,
    )
    envelope = each.envelope
    publisher = envelope.publisher if envelope else None
    return MessageSection(
        id=escape_controls(each.node.removeprefix("#")),
        title=_title(role, publisher, site),
        type=site.anchor(f"{site.types}{schema.ref.name}"),
        body=body,
        received=time_view(envelope.received_ns) if envelope else None,
        sequence=envelope.sequence if envelope else None,
        publisher=iri_view(publisher, site) if publisher else None,
        aside=role == ros.latestFrom,
        picture=picture,
        space=topic_view(schema.ref.name, document.url, site) if role == ros.latest and not query else "",
        is_cloud=schema.ref.name == POINT_CLOUD,
    )


def _title(role: NamedNode, publisher: str | None, site: Site) -> str:
    if role == ros.latestFrom and publisher:
        return f"Latest from {escape_controls(site.short_name(publisher))}"
    return _TITLES.get(role) or capitalize(label(role.value))


_MAX_ROWS = 200
_COLUMNS = ("Role", "Reliability", "Durability", "History", "More")
_TOLD = (ros.reliability, ros.durability)
_TIMES = (ros.deadline, ros.lifespan, ros.lease)
_PLAIN = "automatic"
"""Liveliness without a stated value."""


class EndpointRow(Struct, frozen=True):
    """An endpoint: the node or topic at its other end, and its cells; `wrong` is its problem in words."""

    anchor: Anchor
    cells: tuple[str, ...]
    problem: str = ""


class EndpointTable(Struct, frozen=True):
    """The endpoints of a topic by node, or those of a node by topic; `omitted` is the number of those not shown."""

    heading: str
    columns: tuple[str, ...]
    rows: tuple[EndpointRow, ...]
    omitted: int = 0


def endpoint_table(document: Document, site: Site) -> EndpointTable | None:
    """Return the table of the endpoints of the document's resource, or None without endpoints."""
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
    """Yield the cells that only some endpoints have."""
    if not qos and _first(said, ros.latched) == "true":
        yield "latched"
    for predicate in _TIMES:
        if seconds := _first(qos, predicate):
            yield f"{label(predicate.value)} {seconds} s"
    liveliness = _first(qos, ros.liveliness)
    if liveliness and liveliness != _PLAIN:
        yield f"liveliness {_space_out(liveliness)}"


def _first(statements: Statements, predicate: NamedNode) -> str:
    return escape_controls(
        next((each.value for each in statements.get(predicate, ()) if isinstance(each, Literal)), "")
    )


def _space_out(word: str) -> str:
    return word.replace("_", " ")


_TONES = {ros.Succeeded: "good", ros.Failed: "error", ros.Running: "warning"}


class StepRow(Struct, frozen=True):
    """A step: its description, its subject, the number of subscribers it reached (empty if unknown), and its outcome.

    `tone` is "good", "warning", "error", or empty for a step that was not done.
    """

    does: str
    anchor: Anchor | None
    subscribers: str
    outcome: str
    words: str
    tone: str


class StopSteps(Struct, frozen=True):
    """The steps of a stop that was done, or those of a possible one."""

    title: str
    rows: tuple[StepRow, ...]


def stop_steps(document: Document, site: Site) -> StopSteps | None:
    """Return the steps that a document describes, or None without steps."""
    subjects = outline(document.triples).subjects
    own = subjects.get(NamedNode(document.url), {})
    steps = [term for term in own.get(ros.stopStep, ()) if isinstance(term, NamedNode)]
    if not steps:
        return None
    is_stopped = _text(own.get(ros.stopped, ())) == "true"
    rows = tuple(_step_row(subjects.get(step, {}), site) for step in steps)
    return StopSteps("What was sent" if is_stopped else "What a stop sends", rows)


def _step_row(said: Statements, site: Site) -> StepRow:
    state = next((term for term in said.get(ros.state, ()) if isinstance(term, NamedNode)), ros.NotSent)
    about = next((term for term in said.get(ros.touches, ()) if isinstance(term, NamedNode)), None)
    words, subscribers = escape_controls(_text(said.get(ros.words, ()))), _text(said.get(ros.subscriberCount, ()))
    tone = _TONES.get(state, "")
    return StepRow(
        escape_controls(_text(said.get(rdfs.label, ()))),
        None if about is None else site.anchor(about.value),
        subscribers,
        "" if state == ros.NotSent else label(state.value),
        words,
        "warning" if tone == "good" and words and subscribers else tone,  # a subscriber that was not reached
    )


def _text(terms: Sequence[Term]) -> str:
    return next((term.value for term in terms if isinstance(term, Literal)), "")
