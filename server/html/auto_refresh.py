"""Which pages refresh themselves: those of resources that change without a client. Pure."""

from __future__ import annotations

from pyoxigraph import Literal

from rosld.ontology.vocab import ros
from rosld.server.html.description import objects_of
from rosld.server.html.page import EntryPage, Page

MAX_RATE = 3
"""At most so many times a second a page is brought up to date."""

_ROUTES = frozenset(
    {"", "resources", "nodes", "topics", "services", "actions", "goals", "parameters", "mappings", "calls", "data"}
)
_RECORDING = frozenset({"recording", "armed"})
"""The states of a recording that changes by itself."""
_UNDERWAY = frozenset({ros.Accepted, ros.Executing, ros.Canceling})


def is_refreshed(page: Page | EntryPage) -> bool:
    """Whether a page follows its resource. One that answers a form stays as it is: its reader is in the midst of it."""
    if not all(notice.is_lasting for notice in page.notices) or not page.document.url.startswith(page.site.base):
        return False
    route, _, name = page.document.url.removeprefix(page.site.base).partition("/")
    if route == "calls" and name:
        return ros.Running in objects_of(page.document, ros.state)
    if route == "goals" and name:
        return not _UNDERWAY.isdisjoint(objects_of(page.document, ros.status))
    if route == "bags" and name:
        return not _RECORDING.isdisjoint(
            each.value for each in objects_of(page.document, ros.recordingStatus) if isinstance(each, Literal)
        )
    return route in _ROUTES and not any(form.violations for form in getattr(page, "forms", ()))
