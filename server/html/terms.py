"""RDF terms as views: literals by their datatype, IRIs as links."""

from __future__ import annotations

import json

from pyoxigraph import BlankNode, Literal, NamedNode, Triple

from rosld.ontology.vocab import rdf, xsd
from rosld.server.html.numbers import number_view
from rosld.server.html.page import Cell, Term, Thumbnail
from rosld.server.html.site import Site
from rosld.server.html.timestamps import time_view_of_text
from rosld.server.html.view import (
    ArrayView,
    BytesView,
    LinkView,
    TextView,
    ThumbnailView,
    View,
    escape_controls,
    text_view,
)

_PLAIN = frozenset({xsd.string, rdf.langString})
NUMBERS = frozenset(
    {xsd.integer, xsd.decimal, xsd.float, xsd.double, xsd.byte, xsd.short, xsd.int, xsd.long}
    | {xsd.unsignedByte, xsd.unsignedShort, xsd.unsignedInt, xsd.unsignedLong, xsd.nonNegativeInteger}
)
_LONGEST_JSON = 200_000
_HEAD = 8


def term_view(term: Term, site: Site, here: str = "") -> View:
    """How a term is shown on the page at `here`."""
    if isinstance(term, NamedNode):
        return iri_view(term.value, site, here)
    if isinstance(term, Literal):
        return literal_view(term, site)
    if isinstance(term, BlankNode):
        return TextView(f"_:{term.value}", tone="quiet")
    return _triple_view(term)


def cell_view(cell: Cell, site: Site) -> View:
    """A cell of a listing: text as it is, a term as a term without its datatype."""
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
    """The small picture of a topic, where the reader may see it; else its value in words."""
    anchor = site.anchor(cell.url)
    if anchor is None:
        return text_view(cell.words)
    return ThumbnailView(f"{anchor.href}?{cell.query}", anchor.href, f"Picture of {anchor.text}", cell.words)


def iri_view(iri: str, site: Site, here: str = "") -> View:
    """An IRI as a link, or as text where it must not be one (`javascript:` and its like)."""
    anchor = site.anchor(iri, here)
    return TextView(escape_controls(iri), tone="iri") if anchor is None else LinkView(anchor)


def literal_view(literal: Literal, site: Site) -> View:
    """A literal by its datatype: times readable, arrays shortened, bytes counted, everything else as it is written."""
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
    """The quiet word beside a literal: its language, or its datatype unless it is a plain string."""
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


def _triple_view(triple: Triple) -> View:
    return TextView(escape_controls(f"<<{triple}>>"), tone="iri")
