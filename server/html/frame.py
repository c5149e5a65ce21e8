"""The frame of every page (title, notices, navigation), its assets, and the template environment."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping
from functools import cache
from importlib.resources import files

from jinja2 import DictLoader, Environment, StrictUndefined
from markupsafe import Markup
from msgspec import Struct
from pyoxigraph import Literal

from rosld.ontology.describe_graph import SECTIONS
from rosld.ontology.vocab import ros
from rosld.server.html.cockpit import cockpit_style
from rosld.server.html.description import objects_of
from rosld.server.html.forms import CHOICE_FIELD, METHOD_FIELD
from rosld.server.html.page import EntryPage, Notice, NoticeLevel, Page
from rosld.server.html.site import Anchor, Site, readable_path
from rosld.server.html.view import escape_controls
from rosld.server.http.origin import CSRF_FIELD

MAX_RATE = 3
"""Maximum number of updates of a page per second."""

_ROUTES = frozenset(
    {"", "resources", "nodes", "topics", "services", "actions", "goals", "parameters", "mappings", "calls", "data"}
)
_RECORDING = frozenset({"recording", "armed"})
"""States in which a recording changes by itself."""
_UNDERWAY = frozenset({ros.Accepted, ros.Executing, ros.Canceling})


def is_refreshed(page: Page | EntryPage) -> bool:
    """Whether a page follows its resource. The response to a form does not, as its reader is still editing."""
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


def _read_assets() -> dict[str, bytes]:
    """Return the files of this package and those of third parties, whose licences are in `vendor/`."""
    here = files("rosld.server.html")
    found = (each for folder in (here, here / "vendor") for each in folder.iterdir())
    assets = {each.name: each.read_bytes() for each in found if each.name.endswith((".css", ".js", ".svg"))}
    return {**dict(sorted(assets.items())), "cockpit.css": cockpit_style()}


ASSETS: Mapping[str, bytes] = _read_assets()
"""Contents of files by the path below the base that serves them."""
ASSETS_VERSION = hashlib.blake2b(b"".join(ASSETS.values()), digest_size=4).hexdigest()
"""Digest of all assets: part of their URLs, so that no browser uses an outdated copy."""


_VIEWS = (("space", "Space"), ("graph", "Graph"), ("diagnostics", "Diagnostics"))
_LOUDEST_FIRST = (NoticeLevel.ERROR, NoticeLevel.WARNING, NoticeLevel.GOOD, NoticeLevel.INFO)


_CONTAINERS = {"bags": "recordings"}
"""Containers whose labels differ from their URLs."""


def breadcrumb(site: Site, url: str) -> tuple[Anchor, ...]:
    """Return a link for each level above `url` and one for `url` itself; empty for URLs outside this site."""
    path = url.partition("#")[0].partition("?")[0]
    if not path.startswith(site.base):
        return ()
    parts = path.removeprefix(site.base).split("/")
    leaf = parts.pop()
    crumbs = [_crumb(site, site.base, site.name)]
    here = site.base
    for part in parts:
        here = f"{here}{part}/"
        crumbs.append(_crumb(site, here, _words(part) if len(crumbs) > 1 else _CONTAINERS.get(part) or _words(part)))
    if leaf:
        crumbs.append(_crumb(site, f"{here}{leaf}", _words(leaf)))
    return tuple(crumb for crumb in crumbs if crumb.url == path or site.may("GET", crumb.url))


def _crumb(site: Site, url: str, text: str) -> Anchor:
    return Anchor(site.href(url) or "", text, url)


def _words(segment: str) -> str:
    text = readable_path(segment)
    return escape_controls(text[1:] if text.startswith("~") else text) or "(empty)"


class Frame(Struct, frozen=True):
    """The frame of a page."""

    site: Site
    title: str
    crumbs: tuple[Anchor, ...]
    url: str
    notices: tuple[Notice, ...]
    live: bool = False
    """Whether the page follows its resource while it is open."""
    query: str = ""
    """Text in the search box."""

    def asset(self, name: str) -> str:
        """Return the versioned reference to a file in `ASSETS`. Raises KeyError for unknown names."""
        if name not in ASSETS:
            raise KeyError(name)
        return f"{self.site.root}{name}?v={ASSETS_VERSION}"

    @property
    def can_find(self) -> bool:
        """Whether the reader may search."""
        return self.site.may("GET", f"{self.site.base}find")

    @property
    def navigation(self) -> tuple[tuple[Anchor, bool], ...]:
        """The sections of the site, and whether the page is in each."""
        site = self.site
        sections = [(f"{name}/", SECTIONS.get(name, name.capitalize())) for name in site.sections]
        views = () if "robots" in site.sections else (("cockpit/default", "Cockpit"), *_VIEWS)
        places = (*views, *sections, ("sparql", "SPARQL"))
        found = (Anchor(f"{site.root}{path}", words, f"{site.base}{path}") for path, words in places)
        return tuple((each, self._lies_in(each.url)) for each in found if site.may("GET", each.url))

    def _lies_in(self, section: str) -> bool:
        """Whether the page is in this section; every cockpit belongs to the section of the default one."""
        path = self.url.partition("?")[0]
        return path == section or path.startswith(f"{section.removesuffix('default').removesuffix('/')}/")


def page_frame(
    site: Site, title: str, url: str, notices: tuple[Notice, ...], live: bool = False, query: str = ""
) -> Frame:
    """Return the frame of a page with its notices, the most severe first, including one if the robot is unreachable."""
    stale = (Notice(f"The robot cannot be reached: {site.stale}", NoticeLevel.WARNING),) if site.stale else ()
    ordered = sorted(stale + notices, key=lambda notice: _LOUDEST_FIRST.index(notice.level))
    return Frame(site, escape_controls(title), breadcrumb(site, url), url, tuple(ordered), live, query)


_PARTS = re.compile(r"/?[^/_]+[/_]*|[/_]+")
_LONGEST_WORD = 30
"""Number of characters that fit into a line on a phone."""


@cache
def _environment() -> Environment:
    folder = files("rosld.server.html") / "templates"
    texts = {each.name: each.read_text("utf-8") for each in folder.iterdir() if each.name.endswith(".html")}
    environment = Environment(
        loader=DictLoader(texts),
        autoescape=True,
        undefined=StrictUndefined,
        finalize=_printable,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["breakable"] = _breakable
    environment.filters["grouped"] = lambda number: f"{number:,}"
    environment.globals |= {"csrf_field": CSRF_FIELD, "method_field": METHOD_FIELD, "choice_field": CHOICE_FIELD}
    environment.globals["live_rate"] = MAX_RATE
    return environment


def prepare_pages() -> None:
    """Compile the templates (0.25 s) so that no request waits for that. Thread-safe."""
    environment = _environment()
    for name in environment.list_templates():
        environment.get_template(name)


def render_template(template: str, frame: Frame, **values: object) -> bytes:
    """Return a template of `templates/` rendered with a frame and values, in UTF-8.

    A missing value is an error; an unpaired surrogate becomes a question mark.
    """
    text = _environment().get_template(template).render(frame=frame, site=frame.site, **values)
    return text.encode("utf-8", "replace")


def _breakable(text: str) -> Markup:
    """Return a name with line breaks allowed after slashes and underscores, and within very long words."""
    parts = _PARTS.findall(escape_controls(text))
    name = Markup("<wbr>").join(parts)
    if len(parts) <= 1 or max(map(len, parts)) > _LONGEST_WORD:
        return name
    return Markup('<span class="whole">{}</span>').format(name)


def _printable(value: object) -> object:
    """Replace characters that HTML cannot represent."""
    return escape_controls(value) if type(value) is str else value
