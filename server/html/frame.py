"""The frame of every page: its title, its notices, the navigation to the other sections."""

from __future__ import annotations

from dataclasses import dataclass

from rosld.server.html.assets import ASSETS, ASSETS_VERSION
from rosld.server.html.breadcrumb import breadcrumb
from rosld.server.html.labels import capitalize
from rosld.server.html.page import Notice, NoticeLevel
from rosld.server.html.site import Anchor, Site
from rosld.server.html.view import escape_controls

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
        anchors = [
            Anchor(f"{self.site.root}{name}/", capitalize(name), f"{self.site.base}{name}/")
            for name in self.site.sections
        ]
        anchors.append(Anchor(f"{self.site.root}sparql", "SPARQL", f"{self.site.base}sparql"))
        cockpits = f"{self.site.base}cockpit/"
        cockpit = (Anchor(f"{self.site.root}cockpit/default", "Cockpit", cockpits),) if self._can_see_cockpit else ()
        found = (*cockpit, *(each for each in anchors if self.site.may("GET", each.url)))
        return tuple((each, self.url.startswith(each.url)) for each in found)

    @property
    def _can_see_cockpit(self) -> bool:
        return self.site.may("GET", f"{self.site.base}cockpit/default")


def page_frame(
    site: Site, title: str, url: str, notices: tuple[Notice, ...], live: bool = False, query: str = ""
) -> Frame:
    """The frame of a page: its notices, the loudest first, with one where the robot cannot be seen."""
    stale = (Notice(f"The robot cannot be seen: {site.stale}", NoticeLevel.WARNING),) if site.stale else ()
    ordered = sorted(stale + notices, key=lambda notice: _LOUDEST_FIRST.index(notice.level))
    return Frame(site, escape_controls(title), breadcrumb(site, url), url, tuple(ordered), live, query)
