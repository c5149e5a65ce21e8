"""The page of a cockpit as a value, and the style that puts its panels into their places."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from importlib.resources import files

from rosld.ontology.cockpit import COLUMNS, Cockpit
from rosld.server.html.cockpit_form import CopyForm, EditForm
from rosld.server.html.forms import DeleteForm
from rosld.server.html.page import Csrf, Notice
from rosld.server.html.panels import FilledPanel
from rosld.server.html.site import Site

_ROWS = 99
_WIDE = "(min-width: 48rem)"
"""From which width on there is a grid: below it each panel has the whole width."""


@dataclass(frozen=True, slots=True)
class CockpitPage:
    """The page of a cockpit: its panels as far as the reader may know of them, `hidden` of them left out.

    `others` are the URLs of cockpits with what they are called. Without a form nothing of it is on offer.
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
    """The style of cockpits: policies of pages allow none in attributes, so each place has a rule."""
    own = (files("rosld.server.html") / "cockpit.css").read_bytes()
    return own + "\n".join((f"@media {_WIDE} {{", *_places(), "}", "")).encode("ascii")


def _places() -> Iterator[str]:
    for number in range(1, COLUMNS + 1):
        yield f'.panel[data-column="{number}"] {{ grid-column-start: {number}; }}'
        yield f'.panel[data-width="{number}"] {{ grid-column-end: span {number}; }}'
        yield f'.panel[data-height="{number}"] {{ grid-row-end: span {number}; }}'
    for number in range(1, _ROWS + 1):
        yield f'.panel[data-row="{number}"] {{ grid-row-start: {number}; }}'
