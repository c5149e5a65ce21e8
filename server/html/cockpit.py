"""The page of a cockpit: its panels, their contents and their places."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from importlib.resources import files
from typing import TypeAlias
from urllib.parse import quote

from msgspec import Struct
from msgspec.structs import replace

from rosld.adapters.model import Primitive
from rosld.ontology.cockpit import COLUMNS, Cockpit, Panel, PanelKind
from rosld.ontology.describe_views import PlottedNumber
from rosld.ontology.document import Document, LiftedMessage
from rosld.ontology.fields import field_at
from rosld.ontology.vocab import rdf, ros
from rosld.server.html.cockpit_form import CopyForm, EditForm
from rosld.server.html.description import describe, objects_of
from rosld.server.html.forms import DeleteForm, Form, HoldForm
from rosld.server.html.graphics import PictureView, plot_lines, plot_prefix, plot_query
from rosld.server.html.messages import message_view, scalar_view
from rosld.server.html.offer import FormTarget, PropertyValueView, form_targets, value_of
from rosld.server.html.page import Csrf, Notice, Offer, PageResults
from rosld.server.html.site import Anchor, Site
from rosld.server.html.values import ResultsTable, results_table
from rosld.server.html.view import TableRow, TableView, TextView, View, escape_controls
from rosld.server.hypermedia.views import ComplexView, PropertyView
from rosld.server.robot.diagnostic_states import DiagnosticState, Level

MAX_STREAM = 16
"""Maximum number of series in one stream."""
STREAMS = 3
"""Maximum number of open connections of a page: browsers allow six per server, and two are left for requests."""
MAX_STATES = 12
LEVELS: Mapping[Level, tuple[str, str, str]] = {
    Level.ERROR: ("Error", "Errors", "error"),
    Level.STALE: ("Stale", "Stale", "warning"),
    Level.WARN: ("Warning", "Warnings", "warning"),
    Level.OK: ("OK", "OK", "good"),
}
"""Singular and plural labels of each diagnostic level, and its tone; the worst first."""


class WordsContent(Struct, frozen=True):
    """The reason why a panel shows nothing, as a sentence."""

    words: str


class ValueContent(Struct, frozen=True):
    """A resource: its document and, for a resource below `/resources/`, its view."""

    document: Document
    view: Offer | None


class StatesContent(Struct, frozen=True):
    """Diagnostic states, the worst first."""

    states: tuple[DiagnosticState, ...]


class PlotContent(Struct, frozen=True):
    """Numbers over time, and the references (`y`) that identify them."""

    numbers: tuple[PlottedNumber, ...]
    references: tuple[str, ...]


class PictureContent(Struct, frozen=True):
    """The picture of a topic, and the number of its newest message."""

    view: PictureView
    sequence: int


class FormsContent(Struct, frozen=True):
    """Forms, each with its target URL."""

    forms: tuple[Form, ...]


class DriveContent(Struct, frozen=True):
    """The form of a topic that takes velocity commands."""

    form: HoldForm


class TableContent(Struct, frozen=True):
    """The results of a query."""

    results: PageResults


class SpaceContent(Struct, frozen=True):
    """The view of space at a reference relative to the base."""

    reference: str


PanelContent: TypeAlias = (
    WordsContent
    | ValueContent
    | StatesContent
    | PlotContent
    | PictureContent
    | FormsContent
    | DriveContent
    | TableContent
    | SpaceContent
)


class FilledPanel(Struct, frozen=True):
    """A panel and its current content; `version` changes with the content."""

    panel: Panel
    content: PanelContent
    version: str


class ValueRow(Struct, frozen=True):
    """A named value of a panel."""

    label: str
    value: PropertyValueView
    anchor: Anchor | None = None


class ValueBody(Struct, frozen=True):
    """Named values or, without any, the table of all statements."""

    rows: tuple[ValueRow, ...]
    table: TableView | None = None


class StatesBody(Struct, frozen=True):
    """The first diagnostic states; `more` is the number of the others."""

    states: tuple[DiagnosticState, ...]
    more: int


class PlotBody(Struct, frozen=True):
    """The configuration of the plot as JSON, and links to the plots of single numbers."""

    config: str
    numbers: tuple[Anchor, ...]


PanelBody: TypeAlias = (
    str | ValueBody | StatesBody | PlotBody | PictureView | tuple[FormTarget, ...] | ResultsTable | None
)


class PanelView(Struct, frozen=True):
    """A panel for the template: `part` is the template of its body, `key` identifies it across updates."""

    part: str
    key: str
    title: str
    anchor: Anchor | None
    panel: Panel
    body: PanelBody = None


def panel_views(panels: Sequence[FilledPanel], site: Site, csrf: Csrf) -> tuple[PanelView, ...]:
    """Return the panels for the template."""
    streams = _streams(panels, site)
    left = STREAMS - len(set(map(_stream_of, streams.values())))
    left -= sum(isinstance(each.content, SpaceContent) for each in panels)
    found = []
    for number, filled in enumerate(panels):
        moves = left > 0
        left -= isinstance(filled.content, PictureContent)
        found.append(_view(filled, number, site, csrf, streams.get(number, ""), moves=moves))
    return tuple(found)


def _view(filled: FilledPanel, number: int, site: Site, csrf: Csrf, plot: str, *, moves: bool) -> PanelView:
    panel = filled.panel
    target = panel.shows[0] if panel.shows else ""
    anchor = site.anchor(target) if target else None
    title = escape_controls(panel.title or _default_title(panel, site))
    kind = "unknown" if panel.kind is None else panel.kind.value
    view = PanelView(kind, f"{number} {kind} {target}", title, anchor, panel)
    match filled.content:
        case WordsContent(words):
            return replace(view, part="words", body=escape_controls(words))
        case StatesContent(states):
            return replace(view, part="states", body=StatesBody(states[:MAX_STATES], max(0, len(states) - MAX_STATES)))
        case ValueContent(document) if _is_silent(document):
            return replace(view, part="words", body="No message received yet.")
        case ValueContent():
            return replace(view, part="value", body=_values(filled.content, panel.fields, site))
        case PlotContent(numbers, references):
            href = f"{site.root}plot{plot_query(references)}"
            links = tuple(
                Anchor(f"{site.root}plot{plot_query([reference])}", escape_controls(each.field), reference)
                for each, reference in zip(numbers, references, strict=True)
            )
            return replace(view, part="plot", body=PlotBody(plot, links), anchor=Anchor(href, title, target))
        case PictureContent(picture, sequence):
            return replace(view, part="picture", body=_picture(picture, target, site, sequence, moves=moves))
        case FormsContent(forms):
            return replace(view, part="forms", body=form_targets(forms, (), csrf, site))
        case DriveContent(form):
            return replace(view, part="drive", body=form_targets((_aim_pad(form, site),), (), csrf, site))
        case TableContent(results):
            return replace(view, part="table", body=results_table(results, site))
        case SpaceContent(reference):
            href = f"{site.root}{reference}"
            return replace(view, part="space", body=href, anchor=Anchor(href, title, target))


def _is_silent(document: Document) -> bool:
    """Whether a document describes a topic without a message; its other statements are no values of the robot."""
    is_topic = ros.Topic in objects_of(document, rdf.type)
    return is_topic and not document.messages and not objects_of(document, ros.unreadable)


def _default_title(panel: Panel, site: Site) -> str:
    if panel.kind is PanelKind.PLOT and panel.fields:
        return f"{site.short_name(panel.shows[0])} {', '.join(panel.fields)}"
    return ", ".join(site.short_name(each) for each in panel.shows) or "A panel"


def _aim_pad(form: HoldForm, site: Site) -> HoldForm:
    """Return the form with a pad that contains the path of its topic."""
    path = site.href(form.action) or ""
    return form if form.pad is None else replace(form, pad=replace(form.pad, path=path))


def _picture(view: PictureView, url: str, site: Site, sequence: int, *, moves: bool) -> PictureView:
    """Return the picture with references valid on any page; the URL of a still picture changes with the picture."""
    path = site.href(url) or ""
    still = f"{path}{view.still}" + ("" if moves else f"&v={sequence}")
    return replace(view, still=still, motion=f"{path}{view.motion}" if moves and view.motion else "")


# Values


def _values(content: ValueContent, fields: Sequence[str], site: Site) -> ValueBody:
    """Return the rows of a resource, or else the table of all its statements."""
    view, document = content.view, content.document
    match view:
        case PropertyView(affordance, reading):
            if not fields:
                return ValueBody((ValueRow("", value_of(affordance, reading, view.field, site)),))
            picked = (ValueRow(name, value_of(affordance, reading, each, site)) for each, name in _labels(fields))
            return ValueBody(tuple(picked))
        case ComplexView():
            rows = (
                ValueRow(
                    escape_controls(each.affordance.title or each.affordance.name),
                    value_of(each.affordance, each.reading, each.field, site),
                    site.anchor(each.affordance.url),
                )
                for each in view.members
            )
            return ValueBody(tuple(rows))
    if document.messages:
        message = document.messages[0]
        if fields:
            picked = (ValueRow(name, _field(message, document, each, site)) for each, name in _labels(fields))
            return ValueBody(tuple(picked))
        return ValueBody((), _message(message, document, site))
    sections = describe(document, site)
    return ValueBody((), sections[0].body if sections else None)


def _labels(fields: Sequence[str]) -> Iterator[tuple[str, str]]:
    """Yield paths of fields with their labels: the paths without their common prefix."""
    parts = [each.split(".") for each in fields]
    common = 0
    while len(fields) > 1 and all(len(each) > common + 1 and each[common] == parts[0][common] for each in parts):
        common += 1
    for field, steps in zip(fields, parts, strict=True):
        yield field, escape_controls(".".join(steps[common:]))


def _message(message: LiftedMessage, document: Document, site: Site) -> TableView:
    octets = f"{site.href(document.url) or ''}?field="
    return message_view(
        message.lifter.schema,
        message.message,
        simulated_time=document.simulated_time,
        octets=octets,
        plots=plot_prefix(document.url, site),
    )


def _field(message: LiftedMessage, document: Document, path: str, site: Site) -> PropertyValueView:
    """Return the field of a message at a path."""
    schema = message.lifter.schema
    try:
        kind, value = field_at(schema, message.message, path)
    except ValueError as error:
        return PropertyValueView(None, message=escape_controls(str(error)), failed=True)
    if isinstance(kind, Primitive):
        view = scalar_view(kind, value)
        plots = plot_prefix(document.url, site)
        is_number = isinstance(view, TextView) and view.tone == "number"
        if plots is not None and is_number and isinstance(view, TextView):
            view = replace(view, plot=f"{plots}{quote(path, safe='')}")
        return PropertyValueView(view)
    found = _walk(_message(message, document, site), path.split("."))
    return PropertyValueView(found, message="" if found is not None else "too large to show here")


def _walk(table: TableView, path: Sequence[str]) -> View | None:
    """Return the value in nested tables at a path of labels."""
    view: View = table
    for step in path:
        row = next((each for each in view.rows if each.label == step), None) if isinstance(view, TableView) else None
        if row is None:
            return None
        view = row.values[0]
    return TableView((TableRow(path[-1], (view,)),)) if not isinstance(view, TableView) else view


# Plots


def _streams(panels: Sequence[FilledPanel], site: Site) -> Mapping[int, str]:
    """Return the configuration of each plot by panel number; plots share streams up to `MAX_STREAM` series."""
    found: dict[int, str] = {}
    group: list[tuple[int, PlotContent]] = []
    for number, filled in enumerate(panels):
        if isinstance(filled.content, PlotContent):
            if sum(len(each.numbers) for _, each in group) + len(filled.content.numbers) > MAX_STREAM:
                found.update(_stream(group, site))
                group = []
            group.append((number, filled.content))
    found.update(_stream(group, site))
    return found


def _stream_of(config: str) -> str:
    return str(json.loads(config)["stream"])


def _stream(group: Iterable[tuple[int, PlotContent]], site: Site) -> Mapping[int, str]:
    group = list(group)
    references = list(dict.fromkeys(each for _, content in group for each in content.references))
    stream = f"{site.root}plot{plot_query(references)}"
    return {number: json.dumps({"stream": stream, "y": _lines(content, references, site)}) for number, content in group}


def _lines(content: PlotContent, references: Sequence[str], site: Site) -> list[dict[str, str | int | None]]:
    """Return the lines of a plot, each with its index in the stream."""
    lines = zip(plot_lines(content.numbers, site), content.references, strict=True)
    return [{**line, "place": references.index(reference)} for line, reference in lines]


_ROWS = 99
_WIDE = "(min-width: 48rem)"
"""Media query for screens with a grid; on narrower ones every panel has the full width."""


class CockpitPage(Struct, frozen=True):
    """The page of a cockpit: the panels that the reader may see; `hidden` is the number of the others.

    `others` maps the URLs of cockpits to their titles. Without a `form` the cockpit cannot be edited.
    """

    site: Site
    url: str
    cockpit: Cockpit
    panels: tuple[FilledPanel, ...]
    hidden: int
    others: tuple[tuple[str, str], ...]
    csrf: Csrf
    edit: EditForm | None = None
    copy: CopyForm | None = None
    delete: DeleteForm | None = None
    notices: tuple[Notice, ...] = ()
    suggestions: tuple[str, ...] = ()


def cockpit_style() -> bytes:
    """Return the style sheet of a cockpit: the policy forbids style attributes, so each place has a rule."""
    own = (files("rosld.server.html") / "cockpit.css").read_bytes()
    return own + "\n".join((f"@media {_WIDE} {{", *_places(), "}", "")).encode("ascii")


def _places() -> Iterator[str]:
    for number in range(1, COLUMNS + 1):
        yield f'.panel[data-column="{number}"] {{ grid-column-start: {number}; }}'
        yield f'.panel[data-width="{number}"] {{ grid-column-end: span {number}; }}'
        yield f'.panel[data-height="{number}"] {{ grid-row-end: span {number}; }}'
    for number in range(1, _ROWS + 1):
        yield f'.panel[data-row="{number}"] {{ grid-row-start: {number}; }}'
