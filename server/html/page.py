"""Pages as values for the templates, created for each request."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from enum import Enum
from typing import TYPE_CHECKING, TypeAlias

from msgspec import Struct, field
from pyoxigraph import BlankNode, Literal, NamedNode, Triple

from rosld.ontology.describe_activities import Receipt
from rosld.ontology.describe_views import PlottedNumber, SearchResult
from rosld.ontology.document import Document
from rosld.ontology.syntax import Syntax
from rosld.ontology.violations import Violation
from rosld.server.html.site import Site
from rosld.server.hypermedia import views
from rosld.server.robot.diagnostic_states import DiagnosticState, LevelChange
from rosld.server.space.transforms import FrameNode, Transform

if TYPE_CHECKING:
    from rosld.server.html.forms import Form


Term: TypeAlias = NamedNode | BlankNode | Literal | Triple


class Thumbnail(Struct, frozen=True):
    """A cell with a small picture of a topic: its URL, the query of the picture, and its value in words."""

    url: str
    query: str
    words: str


Cell: TypeAlias = str | NamedNode | Literal | Thumbnail
Csrf: TypeAlias = Callable[[str], str]
"""Function that returns the CSRF token for the target URL of a form (empty for the page's own URL)."""
Offer: TypeAlias = views.View
"""Content of a page below `/resources/`."""


class NoticeLevel(Enum):
    """The severity of a notice."""

    INFO = "info"
    GOOD = "good"
    WARNING = "warning"
    ERROR = "error"


class NoticeLink(Struct, frozen=True):
    """A link of a notice: its target, relative to the page, and its text."""

    href: str
    words: str


class Notice(Struct, frozen=True):
    """An important message at the top of a page, as a sentence; `violations` name invalid fields.

    `link` leads to details. `is_lasting`: whether it remains when the page is updated.
    """

    text: str
    level: NoticeLevel = NoticeLevel.INFO
    violations: tuple[Violation, ...] = ()
    link: NoticeLink | None = None
    is_lasting: bool = False


class Alternate(Struct, frozen=True):
    """Another format of the same resource, at `?format=...`: browsers cannot set Accept."""

    label: str
    media_type: str
    format: str
    query: str = ""
    """Query string of the page itself."""

    @property
    def href(self) -> str:
        """The reference relative to the page."""
        return f"?{self.query}&format={self.format}" if self.query else f"?format={self.format}"


ALTERNATES = (
    *(
        Alternate(syntax.label, syntax.media_type, syntax.extension)
        for syntax in (Syntax.TURTLE, Syntax.JSON_LD, Syntax.N_TRIPLES, Syntax.RDF_XML)
    ),
    Alternate("JSON", "application/json", "json"),
)
"""Formats of every resource in addition to HTML."""
PICTURE_ALTERNATES = (Alternate("JPEG", "image/jpeg", "jpeg"), Alternate("PNG", "image/png", "png"))
"""Further formats of a message that can be drawn."""
CLOUD = Alternate("Points (PLY)", "application/octet-stream", "ply")
"""Further formats of a point cloud."""
THING = Alternate("Thing Description", "application/td+json", "td")
"""Further formats of a complex resource (WoT Thing Description 1.1)."""


def no_csrf_token(action: str) -> str:
    """Return an empty token, for pages without forms."""
    return ""


class SequenceLink(Struct, frozen=True):
    """A link of a sequence such as the messages of a recording: `rel` is first, prev, next or last."""

    rel: str
    url: str


class MemberColumns(Struct, frozen=True):
    """Columns of a container's table: the headings, and the cells of each member by its URL.

    A described resource that is not a direct member (a name in a nested namespace) gets its own row. `total` is the
    number of all members if the table may be incomplete. `names` label members whose URLs end in an identifier,
    `failed` are the URLs of members that failed. `note` is a sentence below the table.
    `is_sorted`: their order matters, so that they are not grouped by name.
    """

    columns: tuple[str, ...] = ()
    cells: Mapping[str, tuple[Cell, ...]] = field(default_factory=dict)
    total: int | None = None
    names: Mapping[str, str] = field(default_factory=dict)
    failed: frozenset[str] = frozenset()
    note: str = ""
    is_sorted: bool = False


class FilterField(Struct, frozen=True):
    """A field of the form that filters a container: its parameter, label and value, and the choices, if few.

    `kind` is the type of its input in HTML.
    """

    name: str
    label: str
    value: str = ""
    choices: tuple[str, ...] = ()
    kind: str = "text"


class Figure(Struct, frozen=True):
    """A picture on a page: its reference, its words for those who do not see it, and links below it by their text."""

    src: str
    alt: str
    links: Mapping[str, str]


class Page(Struct, frozen=True):
    """The page of a resource; it shows those `forms` whose methods `allow` permits, and all that have an `action`.

    `title` is usually a ROS name, `kind` its type ("Topic"); `csrf` creates the tokens of its forms. `summary` is one
    sentence for the reader. The response to an invalid form contains that form with its values. With an `offer` the
    page shows that and folds the triples of the document. `query` is the query string of one page of several
    (`page=2`).
    """

    site: Site
    kind: str
    title: str
    document: Document
    allow: tuple[str, ...] = ("GET", "HEAD", "OPTIONS")
    forms: tuple[Form, ...] = ()
    csrf: Csrf = no_csrf_token
    notices: tuple[Notice, ...] = ()
    listing: MemberColumns | None = None
    steps: tuple[SequenceLink, ...] = ()
    summary: str = ""
    alternates: tuple[Alternate, ...] = ALTERNATES
    offer: Offer | None = None
    query: str = ""
    figure: Figure | None = None
    filters: tuple[FilterField, ...] = ()


class EntryCount(Struct, frozen=True):
    """A line of the entry page: the number of resources and their URL. `first`: whether it is where to begin."""

    label: str
    number: int | None
    url: str
    about: str = ""
    first: bool = False


class EntryPage(Struct, frozen=True):
    """The page at `/`, about this robot. `example` is the URL of a topic worth trying."""

    site: Site
    document: Document
    counts: tuple[EntryCount, ...]
    example: str | None = None
    notices: tuple[Notice, ...] = ()
    alternates: tuple[Alternate, ...] = ALTERNATES


class StoredQueryLink(Struct, frozen=True):
    """A stored query: its URL, its purpose as a sentence, its text."""

    url: str
    name: str
    purpose: str
    text: str


class StoredQueryParameter(Struct, frozen=True):
    """A parameter of a stored query and its description; `value` is the given or the default one."""

    name: str
    about: str = ""
    value: str = ""


class PageResults(Struct, frozen=True):
    """Results of a query: rows of a SELECT (or of a graph, as subject, predicate, object), or a boolean.

    `rows` is consumed only as far as the page shows it: `limit` rows, and one more to detect further rows.
    """

    variables: Sequence[str] = ()
    rows: Iterable[Sequence[Term | None]] = ()
    boolean: bool | None = None
    limit: int = 500
    note: str = ""


class SparqlPage(Struct, frozen=True):
    """The page at `/sparql`: the text in the editor, and whether to request a partial answer."""

    site: Site
    query: str = ""
    examples: tuple[StoredQueryLink, ...] = ()
    results: PageResults | None = None
    notices: tuple[Notice, ...] = ()
    partial: bool = False


class QueryPage(Struct, frozen=True):
    """The page of a stored query."""

    site: Site
    query: StoredQueryLink
    parameters: tuple[StoredQueryParameter, ...] = ()
    results: PageResults | None = None
    notices: tuple[Notice, ...] = ()


class SearchPage(Struct, frozen=True):
    """The page at `/find`: a search box and the results, the best first; `total` is the number of all matches.

    `is_complete` is whether they match all words. `about` has the URLs of what the robot has instead, by concept.
    `pictures` replace the values of results, by URL.
    """

    site: Site
    url: str
    query: str = ""
    results: tuple[SearchResult, ...] = ()
    total: int = 0
    is_complete: bool = True
    about: Mapping[str, str] = field(default_factory=dict)
    notices: tuple[Notice, ...] = ()
    pictures: Mapping[str, Thumbnail] = field(default_factory=dict)


class PlotPage(Struct, frozen=True):
    """The page at `/plot`: numbers over time, and the references (`y`) that identify them."""

    site: Site
    url: str
    numbers: tuple[PlottedNumber, ...] = ()
    references: tuple[str, ...] = ()
    notices: tuple[Notice, ...] = ()


class SpacePage(Struct, frozen=True):
    """The page at `/space`: a view of topics, in drawing order, in the frame `fixed`.

    `wanted` is the requested frame. `references` (`show`) identify the requested topics; `omitted` are those beyond the
    limit. `is_3d`: drawn in three dimensions, with the robot's model at the URL `model`, or empty.
    """

    site: Site
    url: str
    topics: tuple[SpaceTopic, ...]
    fixed: str
    wanted: str = ""
    references: tuple[str, ...] = ()
    frames: tuple[str, ...] = ()
    omitted: int = 0
    notices: tuple[Notice, ...] = ()
    is_3d: bool = False
    model: str = ""


class SpaceTopic(Struct, frozen=True):
    """A topic of a view: its URL, the kind and frame of its messages, and the position of that or why it is unknown."""

    url: str
    kind: str
    frame: str
    pose: Transform | None
    problem: str


class FramesPage(Struct, frozen=True):
    """The page at `/frames`: the frames, each before its descendants; `node_url` is the URL of a node by name."""

    site: Site
    url: str
    nodes: tuple[FrameNode, ...]
    node_url: Callable[[str], str]
    notices: tuple[Notice, ...] = ()


class DiagnosticsPage(Struct, frozen=True):
    """The page at `/diagnostics`: the states of components, the worst first, or only those called `name`.

    `changes` is the history of the named component, the newest first; `topics` are the URLs of the topics.
    """

    site: Site
    url: str
    name: str
    states: tuple[DiagnosticState, ...]
    changes: tuple[LevelChange, ...] = ()
    topics: tuple[str, ...] = ()
    notices: tuple[Notice, ...] = ()


class GraphPage(Struct, frozen=True):
    """The page at `/graph`: `svg` is the drawing, already escaped, with `shown` vertices for `total` resources.

    `below` is the namespace that limits it, `namespaces` are the choices, `problems` are sentences with the URL of the
    resource that has the problem.
    """

    site: Site
    url: str
    svg: str
    shown: int
    total: int
    below: str = ""
    everything: bool = False
    namespaces: tuple[str, ...] = ()
    problems: tuple[tuple[str, str], ...] = ()
    notices: tuple[Notice, ...] = ()


class ProblemPage(Struct, frozen=True):
    """An error page: the members of RFC 9457, and the invalid fields. `url` is that of the request.

    `near` are URLs of resources with similar names, `quotes` quoted texts by speaker.
    """

    site: Site
    status: int
    title: str
    detail: str
    url: str = ""
    violations: tuple[Violation, ...] = ()
    near: tuple[str, ...] = ()
    quotes: tuple[tuple[str, str], ...] = ()


_STEPS = 3
"""Maximum number of steps that a notice lists."""


def receipt_notice(receipt: Receipt, link: NoticeLink | None) -> Notice:
    """Return the notice about a write: what was done, how many subscribers it reached, or why it was refused."""
    if receipt.status >= 400:
        return Notice(f"Not done: {receipt.words or 'it was refused'}", NoticeLevel.ERROR, link=link, is_lasting=True)
    steps = "; ".join(receipt.plan[:_STEPS]) or f"{receipt.method} was carried out"
    more = f"; and {len(receipt.plan) - _STEPS} more" if len(receipt.plan) > _STEPS else ""
    if receipt.matched is None:
        return Notice(f"Done: {steps}{more}.", NoticeLevel.GOOD, link=link, is_lasting=True)
    if not receipt.matched:
        return Notice(f"Done: {steps}{more}. It had no subscriber.", NoticeLevel.WARNING, link=link, is_lasting=True)
    whom = "one subscriber" if receipt.matched == 1 else f"{receipt.matched} subscribers"
    return Notice(f"Done: {steps}{more}. It reached {whom}.", NoticeLevel.GOOD, link=link, is_lasting=True)
