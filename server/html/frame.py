"""The frame of every page: its title, its notices, the navigation to the other sections."""

from __future__ import annotations

from dataclasses import dataclass

from rosld.ontology.describe_graph import SECTIONS
from rosld.server.html.assets import ASSETS, ASSETS_VERSION
from rosld.server.html.breadcrumb import breadcrumb
from rosld.server.html.page import Notice, NoticeLevel
from rosld.server.html.site import Anchor, Site
from rosld.server.html.view import escape_controls

_VIEWS = (("space", "Space"), ("graph", "Graph"), ("diagnostics", "Diagnostics"))
_LOUDEST_FIRST = (NoticeLevel.ERROR, NoticeLevel.WARNING, NoticeLevel.GOOD, NoticeLevel.INFO)


@dataclass(frozen=True, slots=True)
class Frame:
    """The frame of a page."""

    site: Site
    title: str
    crumbs: tuple[Anchor, ...]
    url: str
    notices: tuple[Notice, ...]
    live: bool = False
    """Whether it follows its resource while it is looked at."""
    query: str = ""
    """What stands in the box that searches."""

    def asset(self, name: str) -> str:
        """The reference to a file of `ASSETS`, in the version that is served now. Raises KeyError for any other."""
        if name not in ASSETS:
            raise KeyError(name)
        return f"{self.site.root}{name}?v={ASSETS_VERSION}"

    @property
    def can_find(self) -> bool:
        """Whether the reader may search."""
        return self.site.may("GET", f"{self.site.base}find")

    @property
    def navigation(self) -> tuple[tuple[Anchor, bool], ...]:
        """The sections of the site, and whether the page lies in each."""
        site = self.site
        sections = [(f"{name}/", SECTIONS[name]) for name in site.sections]
        places = (("cockpit/default", "Cockpit"), *_VIEWS, *sections, ("sparql", "SPARQL"))
        found = (Anchor(f"{site.root}{path}", words, f"{site.base}{path}") for path, words in places)
        return tuple((each, self._lies_in(each.url)) for each in found if site.may("GET", each.url))

    def _lies_in(self, section: str) -> bool:
        """Whether the page is this section or below it; the default cockpit stands for all."""
        path = self.url.partition("?")[0]
        return path == section or path.startswith(f"{section.removesuffix('default').removesuffix('/')}/")


def page_frame(
    site: Site, title: str, url: str, notices: tuple[Notice, ...], live: bool = False, query: str = ""
) -> Frame:
    """The frame of a page: its notices, the loudest first, with one where the robot cannot be seen."""
    stale = (Notice(f"The robot cannot be seen: {site.stale}", NoticeLevel.WARNING),) if site.stale else ()
    ordered = sorted(stale + notices, key=lambda notice: _LOUDEST_FIRST.index(notice.level))
    return Frame(site, escape_controls(title), breadcrumb(site, url), url, tuple(ordered), live, query)
