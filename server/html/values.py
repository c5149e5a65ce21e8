"""Values of properties: how one is shown, and as what plain JSON it stands in a form."""

from __future__ import annotations

from dataclasses import replace
from typing import cast
from urllib.parse import quote

from rosld.ontology.body import parse_json
from rosld.ontology.lift import LiftSettings
from rosld.server.html.inputs import Json, editable_json
from rosld.server.html.messages import message_view
from rosld.server.html.plot import plot_prefix
from rosld.server.html.site import Site
from rosld.server.html.terms import cell_view
from rosld.server.html.view import TextView, View, escape_controls, text_view
from rosld.server.hypermedia.value import MessageValue, Value, plain_json, value_literal

_LIFTING = LiftSettings()


def value_view(value: Value, site: Site, field: str | None = None) -> View:
    """How a value is shown; with `field`, one scalar of it by its dotted path."""
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
    """The view with a link to its plot, where it is a number of a topic."""
    if not isinstance(value, MessageValue) or not isinstance(view, TextView) or view.tone != "number":
        return view
    plots, path = plot_prefix(value.origin, site), field or value.fields[0].name
    return view if plots is None else replace(view, plot=f"{plots}{quote(path, safe='')}")


def plain_value(value: Value | None) -> Json:
    """The plain JSON that a form of the value is filled with: the bare scalar, or an object of its fields.

    None where there is no value, or none that could be typed.
    """
    try:
        return None if value is None else cast(Json, parse_json(plain_json(value, _LIFTING)))
    except ValueError:
        return None
