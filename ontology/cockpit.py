"""Cockpits: panels in a grid, read from RDF and written as RDF. Pure."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from enum import Enum

from msgspec import Struct
from msgspec.structs import replace
from pyoxigraph import BlankNode, Literal, NamedNode, Triple

from rosld.ontology.triples import integer, labelled, statements, text, triples_about
from rosld.ontology.vocab import dcterms, rdf, rdfs, ros

COLUMNS = 12
"""Number of columns of the grid."""
_LAST = 1 << 16
_DIGITS = re.compile(r"([0-9]{1,9})")
_OWN = frozenset({ros.hasPanel, dcterms.title, rdfs.label})


class PanelKind(Enum):
    """Kind of a panel's content."""

    PLOT = "plot"
    PICTURE = "picture"
    SPACE = "space"
    VALUE = "value"
    DRIVE = "drive"
    BUTTON = "button"
    QUERY = "query"

    @property
    def type(self) -> NamedNode:
        """The class of its panels."""
        return _TYPES[self]


_TYPES: Mapping[PanelKind, NamedNode] = {
    PanelKind.PLOT: ros.PlotPanel,
    PanelKind.PICTURE: ros.PicturePanel,
    PanelKind.SPACE: ros.SpacePanel,
    PanelKind.VALUE: ros.ValuePanel,
    PanelKind.DRIVE: ros.DrivePanel,
    PanelKind.BUTTON: ros.ButtonPanel,
    PanelKind.QUERY: ros.QueryPanel,
}
_KINDS: Mapping[NamedNode, PanelKind] = {type: kind for kind, type in _TYPES.items()}


class GridArea(Struct, frozen=True):
    """A place in the grid: its first column and row (None for the next free one), and its width and height."""

    width: int = 4
    height: int = 3
    column: int | None = None
    row: int | None = None


class Panel(Struct, frozen=True):
    """A panel of a cockpit: its kind, resources, fields, and place.

    `kind` is None for an unknown type, which `type` names.
    """

    kind: PanelKind | None
    shows: tuple[str, ...] = ()
    fields: tuple[str, ...] = ()
    title: str = ""
    area: GridArea = GridArea()
    type: str = ""


class Cockpit(Struct, frozen=True):
    """A cockpit: its title, and its panels from top to bottom."""

    title: str
    panels: tuple[Panel, ...] = ()


NOTHING = Cockpit("")


def read_cockpit(triples: Iterable[Triple], url: str) -> Cockpit:
    """Return the cockpit that a document at a URL describes; everything in it is optional."""
    statements: dict[object, dict[NamedNode, list[object]]] = defaultdict(lambda: defaultdict(list))
    for subject, predicate, value in triples:
        statements[subject][predicate].append(value)
    own = statements.get(NamedNode(url), {})
    nodes = [node for node in own.get(ros.hasPanel, ()) if isinstance(node, NamedNode | BlankNode)]
    found = [(_order(node.value), _panel(statements.get(node, {}))) for node in dict.fromkeys(nodes)]
    found.sort(key=lambda each: (each[1].area.row or _LAST, each[1].area.column or _LAST, each[0]))
    return Cockpit(_text(own.get(dcterms.title, ())), tuple(panel for _, panel in found))


def _order(name: str) -> list[tuple[int, str]]:
    """Return a sort key that puts `panel.2` before `panel.10`."""
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in _DIGITS.split(name)]


def _panel(statements: Mapping[NamedNode, Sequence[object]]) -> Panel:
    types = [each for each in statements.get(rdf.type, ()) if isinstance(each, NamedNode)]
    kind = next((_KINDS[each] for each in types if each in _KINDS), None)
    default = GridArea()
    area = GridArea(
        _number(statements.get(ros.gridWidth, ())) or default.width,
        _number(statements.get(ros.gridHeight, ())) or default.height,
        _number(statements.get(ros.gridColumn, ())),
        _number(statements.get(ros.gridRow, ())),
    )
    return Panel(
        kind,
        tuple(each.value for each in statements.get(ros.shows, ()) if isinstance(each, NamedNode)),
        tuple(each.value for each in statements.get(ros.fieldPath, ()) if isinstance(each, Literal)),
        _text(statements.get(dcterms.title, ())),
        replace(area, width=min(area.width, COLUMNS + 1 - (area.column or 1))),
        "" if kind is not None else next((each.value for each in types if each != ros.Panel), ""),
    )


def _text(values: Iterable[object]) -> str:
    return next((each.value for each in values if isinstance(each, Literal)), "")


def _number(values: Iterable[object]) -> int | None:
    found = _text(values)
    return int(found) if found.isdecimal() and len(found) < 4 else None


def cockpit_triples(url: str, cockpit: Cockpit) -> list[Triple]:
    """Return a cockpit as triples of the document at a URL."""
    nodes = [NamedNode(f"{url}#panel.{number}") for number in range(1, len(cockpit.panels) + 1)]
    triples = triples_about(
        NamedNode(url),
        (rdf.type, ros.Cockpit),
        *labelled(dcterms.title, cockpit.title or None),
        *statements(ros.hasPanel, nodes),
    )
    for node, panel in zip(nodes, cockpit.panels, strict=True):
        triples += triples_about(
            node,
            (rdf.type, NamedNode(panel.type) if panel.kind is None else panel.kind.type),
            (dcterms.title, text(panel.title or None)),
            *statements(ros.shows, map(NamedNode, panel.shows)),
            *((ros.fieldPath, text(field)) for field in panel.fields),
            (ros.gridColumn, integer(panel.area.column)),
            (ros.gridRow, integer(panel.area.row)),
            (ros.gridWidth, integer(panel.area.width)),
            (ros.gridHeight, integer(panel.area.height)),
        )
    return triples


def without_cockpit(triples: Sequence[Triple], url: str) -> list[Triple]:
    """Return the triples of a document without the title and panels of its cockpit."""
    document = NamedNode(url)
    panels = {each.object for each in triples if each.subject == document and each.predicate == ros.hasPanel}
    return [
        each
        for each in triples
        if each.subject not in panels and not (each.subject == document and each.predicate in _OWN)
    ]
