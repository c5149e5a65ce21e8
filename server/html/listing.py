"""The table of a container: members by name, each followed by the namespace of the same name."""

from __future__ import annotations

from msgspec import Struct
from pyoxigraph import Literal, NamedNode

from rosld.ontology.document import Document
from rosld.ontology.vocab import ldp, rdf, rdfs, ros
from rosld.server.html.description import objects_of
from rosld.server.html.labels import NameGroup, group_names, label
from rosld.server.html.page import Cell, MemberColumns, Thumbnail
from rosld.server.html.site import Anchor, Site
from rosld.server.html.values import cell_view
from rosld.server.html.view import View, escape_controls

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
    containers = {url for url in urls if url.endswith("/") and url.removesuffix("/") not in anchors}
    members = tuple(
        ListingRow(
            anchors[url],
            _cells(cells.get(url, ()), len(columns), site),
            anchors.get(f"{url}/"),
            listing is not None and url in listing.failed,
        )
        for url in urls
        if not url.endswith("/")
    )
    namespaces = tuple(anchors[url] for url in urls if url in containers)
    groups = group_names(members, lambda row: row.anchor.text)
    return ContainerTable(columns, members, namespaces, total, groups, listing.note if listing and members else "")


def parameters_below(document: Document) -> tuple[NamedNode, ...]:
    """Return the parameters and trees of parameters in a document about a tree of parameters."""
    told = {each.subject for each in document.triples if each.predicate == rdf.type and each.object == ros.Parameter}
    own = NamedNode(document.url)
    is_tree = own in told and ldp.Container in objects_of(document, rdf.type)
    return tuple(each for each in told - {own} if isinstance(each, NamedNode)) if is_tree else ()


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
