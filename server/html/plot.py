"""Plots on pages: what the script is given, and the rows of the table of numbers."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from urllib.parse import quote

from rosld.server.html.page import PlotPage
from rosld.server.html.site import Anchor, Site


@dataclass(frozen=True, slots=True)
class PlotRow:
    """A number in the table: its topic, field and type, what is recorded of it, and the plot without it."""

    topic: Anchor | None
    field: str
    type: str
    series: str | None
    without: str


def plot_query(references: Sequence[str]) -> str:
    """The query of the plot of these numbers."""
    return "?" + "&".join(f"y={quote(each, safe='/:')}" for each in references) if references else ""


def plot_config(page: PlotPage) -> str:
    """What the script draws from, as JSON: the stream of the numbers, and of each its label and what is recorded."""
    names = {number.topic for number in page.numbers}
    numbers = [
        {
            "label": number.field if len(names) == 1 else f"{page.site.short_name(number.topic)} {number.field}",
            "series": None if number.series is None else page.site.href(number.series),
        }
        for number in page.numbers
    ]
    return json.dumps({"stream": f"{page.site.root}plot{plot_query(page.references)}", "y": numbers})


def plot_prefix(topic: str, site: Site) -> str | None:
    """The reference of the plot of a field of the topic at a URL, but for the field's path; None where none may be."""
    path = site.href(topic)
    if path is None or not topic.startswith(f"{site.base}topics/") or not site.may("GET", f"{site.base}plot"):
        return None
    below = topic.removeprefix(site.base)
    return f"{site.root}plot?y={quote(f'{below}#', safe='/:')}"
