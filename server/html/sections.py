"""Sections of pages: messages, endpoints, the steps of a stop, and the table of a container."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

from msgspec import Struct
from msgspec.structs import replace
from pyoxigraph import BlankNode, Literal, NamedNode

from rosld.ontology.document import Document, LiftedMessage
from rosld.ontology.outline import Statements, outline
from rosld.ontology.vocab import ldp, rdf, rdfs, ros
from rosld.server.html.description import objects_of
from rosld.server.html.graphics import PictureView, picture_view, plot_prefix, topic_view
from rosld.server.html.labels import NameGroup, capitalize, group_names, label
from rosld.server.html.messages import message_view
from rosld.server.html.page import Cell, MemberColumns, Term, Thumbnail
from rosld.server.html.site import Anchor, Site
from rosld.server.html.values import cell_view, iri_view
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
    columns = [place for place in range(len(_COLUMNS)) if any(row.cells[place] for row in rows)]
    return EndpointTable(
        "Topic" if of_node else "Node",
        tuple(_COLUMNS[place] for place in columns),
        tuple(replace(row, cells=tuple(row.cells[place] for place in columns)) for row in rows),
        len(found) - len(rows),
    )


def _row(
    endpoint: NamedNode, subjects: dict[NamedNode | BlankNode, Statements], to: NamedNode, site: Site
) -> EndpointRow:
    own = subjects.get(endpoint, {})
    qos: Statements = next(
        (subjects[each] for each in own.get(ros.hasQos, ()) if isinstance(each, NamedNode) and each in subjects), {}
    )
    other = next((each.value for each in own.get(to, ()) if isinstance(each, NamedNode)), endpoint.value)
    role = "publishes" if ros.Publisher in own.get(rdf.type, ()) else "subscribes"
    reliability, durability = (_first(qos, predicate) for predicate in _TOLD)
    history, depth = _first(qos, ros.history), _first(qos, ros.depth)
    conflicting = [each.value for each in own.get(ros.conflictingType, ()) if isinstance(each, NamedNode)]
    wrong = [_first(own, ros.unreachable), *(f"uses {site.short_name(each)}" for each in conflicting)]
    return EndpointRow(
        site.anchor(other) or Anchor("", escape_controls(other), other),
        (
            role,
            _space_out(reliability),
            _space_out(durability),
            " ".join(filter(None, (_space_out(history), depth))),
            ", ".join(_more(own, qos)),
        ),
        escape_controls("; ".join(filter(None, wrong))),
    )


def _more(own: Statements, qos: Statements) -> Iterable[str]:
    """Yield the cells that only some endpoints have."""
    if not qos and _first(own, ros.latched) == "true":
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


def stop_steps(document: Document, site: Site) -> Mapping[str, object] | None:
    """Return the steps that a document describes, or None without steps."""
    subjects = outline(document.triples).subjects
    own = subjects.get(NamedNode(document.url), {})
    steps = [term for term in own.get(ros.stopStep, ()) if isinstance(term, NamedNode)]
    if not steps:
        return None
    is_stopped = _text(own.get(ros.stopped, ())) == "true"
    rows = tuple(_step_row(subjects.get(step, {}), site) for step in steps)
    return {"title": "What was sent" if is_stopped else "What a stop sends", "rows": rows}


def _step_row(own: Statements, site: Site) -> Mapping[str, object]:
    """Return a step; `tone` is "good", "warning", "error", or empty for a step that was not done."""
    state = next((term for term in own.get(ros.state, ()) if isinstance(term, NamedNode)), ros.NotSent)
    about = next((term for term in own.get(ros.touches, ()) if isinstance(term, NamedNode)), None)
    words, subscribers = escape_controls(_text(own.get(ros.words, ()))), _text(own.get(ros.subscriberCount, ()))
    tone = _TONES.get(state, "")
    return {
        "does": escape_controls(_text(own.get(rdfs.label, ()))),
        "anchor": None if about is None else site.anchor(about.value),
        "subscribers": subscribers,
        "outcome": "" if state == ros.NotSent else label(state.value),
        "words": words,
        "tone": "warning" if tone == "good" and words and subscribers else tone,  # a subscriber that was not reached
    }


def _text(terms: Sequence[Term]) -> str:
    return next((term.value for term in terms if isinstance(term, Literal)), "")


_MAX_COLUMNS = 4
_NO_COLUMNS = frozenset({rdf.type, ros.name, rdfs.label, rdfs.comment, ros.namespace})


class ListingRow(Struct, frozen=True):
    """A member of a container: its link, its cells, and the container of the same name, if any."""

    anchor: Anchor
    cells: tuple[tuple[View, ...], ...]
    namespace: Anchor | None = None
    is_failed: bool = False


class ContainerTable(Struct, frozen=True):
    """The table of a container: `members`, and `namespaces` without a member of the same name.

    `groups` contains the members if there are many; the page folds them.
    """

    columns: tuple[str, ...]
    members: tuple[ListingRow, ...]
    namespaces: tuple[Anchor, ...]
    total: int
    groups: tuple[NameGroup[ListingRow], ...] = ()
    note: str = ""


def container_table(document: Document, site: Site, listing: MemberColumns | None) -> ContainerTable | None:
    """Return the table of a document about a container or a listing, else None."""
    urls = [term.value for term in objects_of(document, ldp.contains) if isinstance(term, NamedNode)]
    if not urls and listing is None:
        return None
    columns, cells = (listing.columns, listing.cells) if listing and listing.columns else _columns(document, urls)
    if site.is_restricted:
        cells = {
            url: tuple(_redact_cell(cell, site) for cell in row) for url, row in cells.items() if site.may("GET", url)
        }
    counted = len(cells.keys() | {url for url in urls if not url.endswith("/")} if listing and listing.cells else urls)
    total = listing.total if listing and listing.total is not None and not site.is_restricted else counted
    urls += [url for url in cells if url not in set(urls) and listing is not None and url in listing.cells]
    names = listing.names if listing else {}
    anchors = {url: _anchor(site, url, document.url, names.get(url)) for url in urls}
    containers = {
        url for url in urls if url.endswith("/") and url.removesuffix("/") not in anchors and url not in cells
    }
    members = tuple(
        ListingRow(
            anchors[url],
            _cells(cells.get(url, ()), len(columns), site),
            anchors.get(f"{url}/"),
            listing is not None and url in listing.failed,
        )
        for url in urls
        if not url.endswith("/") or (listing is not None and url in cells)
    )
    namespaces = tuple(anchors[url] for url in urls if url in containers)
    groups = () if listing and listing.is_sorted else group_names(members, lambda row: row.anchor.text)
    return ContainerTable(columns, members, namespaces, total, groups, listing.note if listing and members else "")


def parameters_below(document: Document) -> tuple[NamedNode, ...]:
    """Return the parameters and trees of parameters in a document about a tree of parameters."""
    parameters = {
        each.subject for each in document.triples if each.predicate == rdf.type and each.object == ros.Parameter
    }
    own = NamedNode(document.url)
    is_tree = own in parameters and ldp.Container in objects_of(document, rdf.type)
    return tuple(each for each in parameters - {own} if isinstance(each, NamedNode)) if is_tree else ()


def parameter_columns(document: Document, listing: MemberColumns | None) -> MemberColumns | None:
    """Return the values of all parameters of a tree for its table; None for other resources."""
    below = set(parameters_below(document))
    if not below:
        return None
    cells: dict[str, tuple[Cell, ...]] = {
        each.subject.value: (each.object,)
        for each in document.triples
        if each.predicate == ros.value and each.subject in below and isinstance(each.object, Literal | NamedNode)
        if isinstance(each.subject, NamedNode)
    }
    return MemberColumns(("value",), dict(sorted(cells.items())), None if listing is None else listing.total)


def _redact_cell(cell: Cell, site: Site) -> Cell:
    """Return a cell without content that the reader may not see."""
    url = cell.value if isinstance(cell, NamedNode) else cell.url if isinstance(cell, Thumbnail) else None
    return cell if url is None or site.may("GET", url) else ""


def _anchor(site: Site, url: str, container: str, name: str | None = None) -> Anchor:
    """Return the link to a member, labelled by default with its name within the container."""
    found = site.anchor(url) or Anchor("", escape_controls(url), url)
    if name:
        return Anchor(found.href, escape_controls(name), url, found.external)
    inner = site.short_name(url).removeprefix(site.short_name(container)).lstrip("/")
    return Anchor(found.href, escape_controls(inner or found.text), url, found.external)


def _cells(cells: tuple[Cell, ...], width: int, site: Site) -> tuple[tuple[View, ...], ...]:
    views = tuple((cell_view(cell, site),) if cell != "" else () for cell in cells[:width])
    return views + ((),) * (width - len(views))


def _columns(document: Document, urls: list[str]) -> tuple[tuple[str, ...], dict[str, tuple[Cell, ...]]]:
    members = set(urls)
    found: dict[str, dict[NamedNode, Cell]] = {}
    predicates: dict[NamedNode, None] = {}
    for triple in document.triples:
        if isinstance(triple.subject, NamedNode) and triple.subject.value in members:
            if triple.predicate in _NO_COLUMNS or not isinstance(triple.object, NamedNode | Literal):
                continue
            predicates[triple.predicate] = None
            found.setdefault(triple.subject.value, {})[triple.predicate] = triple.object
    chosen = tuple(predicates)[:_MAX_COLUMNS]
    rows = {url: tuple(cells.get(predicate, "") for predicate in chosen) for url, cells in found.items()}
    return tuple(label(predicate.value) for predicate in chosen), rows
