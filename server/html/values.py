"""Values for people: RDF terms, tables, brief values, and readings."""

from __future__ import annotations

import json
from collections.abc import Iterator
from itertools import islice
from typing import cast
from urllib.parse import quote

from msgspec import Struct
from msgspec.structs import replace
from pyoxigraph import BlankNode, Literal, NamedNode

from rosld.ontology.body import parse_json
from rosld.ontology.lift import LiftSettings
from rosld.ontology.vocab import rdf, xsd
from rosld.server.html.graphics import plot_prefix
from rosld.server.html.inputs import Json, editable_json
from rosld.server.html.messages import message_view
from rosld.server.html.page import Cell, PageResults, Term, Thumbnail
from rosld.server.html.site import Site
from rosld.server.html.view import (
    ArrayView,
    BytesView,
    LinkView,
    TextView,
    ThumbnailView,
    View,
    escape_controls,
    number_view,
    text_view,
    time_view_of_text,
)
from rosld.server.hypermedia.value import MessageValue, Value, plain_json, value_literal

_PLAIN = frozenset({xsd.string, rdf.langString})
NUMBERS = frozenset(
    {xsd.integer, xsd.decimal, xsd.float, xsd.double, xsd.byte, xsd.short, xsd.int, xsd.long}
    | {xsd.unsignedByte, xsd.unsignedShort, xsd.unsignedInt, xsd.unsignedLong, xsd.nonNegativeInteger}
)
_LONGEST_JSON = 200_000
_HEAD = 8


def term_view(term: Term, site: Site, here: str = "") -> View:
    """Return the view of a term on the page at `here`."""
    if isinstance(term, NamedNode):
        return iri_view(term.value, site, here)
    if isinstance(term, Literal):
        return literal_view(term, site)
    if isinstance(term, BlankNode):
        return TextView(f"_:{term.value}", tone="quiet")
    return TextView(escape_controls(f"<<{term}>>"), tone="iri")


def cell_view(cell: Cell, site: Site) -> View:
    """Return the view of a table cell: a text unchanged, a term without its datatype."""
    if isinstance(cell, str):
        return text_view(cell)
    if isinstance(cell, Thumbnail):
        return thumbnail_view(cell, site)
    if isinstance(cell, Literal) and (cell.datatype in NUMBERS or cell.datatype == xsd.boolean):
        return number_view(cell.value)
    if isinstance(cell, Literal) and cell.datatype == xsd.dateTime:
        return time_view_of_text(escape_controls(cell.value))
    return term_view(cell, site)


def thumbnail_view(cell: Thumbnail, site: Site) -> View:
    """Return the small picture of a topic if the reader may see it, else its value in words."""
    anchor = site.anchor(cell.url)
    if anchor is None:
        return text_view(cell.words)
    return ThumbnailView(f"{anchor.href}?{cell.query}", anchor.href, f"Picture of {anchor.text}", cell.words)


def iri_view(iri: str, site: Site, here: str = "") -> View:
    """Return an IRI as a link, or as text if it must not be a link (such as `javascript:`)."""
    anchor = site.anchor(iri, here)
    return TextView(escape_controls(iri), tone="iri") if anchor is None else LinkView(anchor)


def literal_view(literal: Literal, site: Site) -> View:
    """Return the view of a literal by its datatype: readable times, short arrays, counted bytes, others unchanged."""
    datatype = literal.datatype
    hint = literal_hint(literal, site)
    if datatype == xsd.dateTime:
        return time_view_of_text(escape_controls(literal.value), hint)
    if datatype == rdf.JSON:
        return _json_view(literal.value)
    if datatype == xsd.base64Binary:
        return BytesView(len(literal.value) * 3 // 4 - literal.value[-2:].count("="), hint=hint)
    if datatype in NUMBERS:
        return number_view(literal.value, hint)
    return text_view(literal.value, hint)


def literal_hint(literal: Literal, site: Site) -> str:
    """Return the hint of a literal: its language, or its datatype unless it is a plain string."""
    if literal.language:
        return literal.language if literal.language != "en" else ""
    if literal.datatype in _PLAIN:
        return ""
    if literal.datatype.value.startswith(xsd.iri):
        return escape_controls(literal.datatype.value.removeprefix(xsd.iri))
    return escape_controls(site.prefixed_name(literal.datatype.value))


def _json_view(text: str) -> View:
    try:
        value = json.loads(text) if len(text) <= _LONGEST_JSON else None
    except (ValueError, RecursionError):
        value = None
    if not isinstance(value, list):
        return text_view(text, "JSON")
    items = [each if isinstance(each, str) else json.dumps(each, ensure_ascii=False) for each in value[:2_000]]
    head, full = escape_controls(", ".join(items[:_HEAD])), escape_controls(", ".join(items))
    return ArrayView(len(value), head, full if len(value) > _HEAD else None, hint="JSON")


class ResultsTable(Struct, frozen=True):
    """Rows of views under headings; `cut` says that there were more rows than are shown."""

    columns: tuple[str, ...]
    rows: tuple[tuple[View | None, ...], ...]
    is_truncated: bool = False
    boolean: bool | None = None
    note: str = ""


def results_table(results: PageResults, site: Site) -> ResultsTable:
    """Return the table of a query's results, with at most `results.limit` rows."""
    columns = tuple(escape_controls(name) for name in results.variables)
    if results.boolean is not None:
        return ResultsTable(columns, (), boolean=results.boolean, note=results.note)
    rows_read = list(islice(results.rows, results.limit + 1))
    rows = tuple(tuple(_view(term, site) for term in row) for row in rows_read[: results.limit])
    return ResultsTable(columns, rows, is_truncated=len(rows_read) > results.limit, note=results.note)


def _view(term: Term | None, site: Site) -> View | None:
    if term is None:
        return None
    return cell_view(term, site) if isinstance(term, Literal) else term_view(term, site)


_MAX_CHARACTERS = 110
_MORE = "..."


def brief_text(value: str) -> str:
    """Return the text of a brief value on one line, shortened if necessary."""
    parsed: object = json.loads(value)
    if isinstance(parsed, dict) and parsed.keys() == {"data"}:
        parsed = parsed["data"]
    parts = list(_parts(parsed, ""))
    line = ", ".join(part for part in parts if part != _MORE)
    if len(line) > _MAX_CHARACTERS:
        cut = line[:_MAX_CHARACTERS]
        return escape_controls(f"{cut.rpartition(',')[0] or cut} …")
    return escape_controls(f"{line} …".lstrip() if _MORE in parts else line)


def _parts(value: object, path: str) -> Iterator[str]:
    """Yield the scalars of a value, each with its path."""
    if isinstance(value, dict):
        for name, inner in value.items():
            if name == _MORE:
                yield _MORE
            else:
                yield from _parts(inner, f"{path}.{name}" if path else name)
    elif isinstance(value, list) and any(isinstance(each, dict) for each in value):
        for index, inner in enumerate(value):
            yield from _parts(inner, f"{path}[{index}]") if inner != _MORE else iter([_MORE])
    else:
        text = _scalar(value) if not isinstance(value, list) else f"[{', '.join(map(_scalar, value))}]"
        yield f"{path} {text}" if path else text


def _scalar(value: object) -> str:
    if isinstance(value, float):
        return f"{value:.6g}"
    return value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)


_LIFTING = LiftSettings()


def value_view(value: Value, site: Site, field: str | None = None) -> View:
    """Return the view of a value, or of one of its scalars by the dotted path `field`."""
    try:
        scalar = value_literal(value, field)
    except ValueError as error:
        return TextView(escape_controls(str(error)), tone="none")
    if scalar is not None:
        return _with_plot_link(cell_view(scalar, site), value, field, site)
    if isinstance(value, MessageValue):
        octets = f"{site.href(value.origin)}?field="
        plots = plot_prefix(value.origin, site)
        return message_view(value.schema, value.message, fields=value.fields, octets=octets, plots=plots)
    return text_view(editable_json(plain_value(value), indent=2))


def _with_plot_link(view: View, value: Value, field: str | None, site: Site) -> View:
    """Return the view, with a link to its plot for a number of a topic."""
    if not isinstance(value, MessageValue) or not isinstance(view, TextView) or view.tone != "number":
        return view
    plots, path = plot_prefix(value.origin, site), field or value.fields[0].name
    return view if plots is None else replace(view, plot=f"{plots}{quote(path, safe='')}")


def plain_value(value: Value | None) -> Json:
    """Return the plain JSON that fills a form for the value: the bare scalar, or an object of its fields.

    None if there is no value, or none that can be edited.
    """
    try:
        return None if value is None else cast(Json, parse_json(plain_json(value, _LIFTING)))
    except ValueError:
        return None
