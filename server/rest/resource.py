"""Base class of resources: everything that has a URL.

A resource is created for a request and has no state of its own: `state()` returns the current one. The methods listed
by `methods()` are coroutines of the same names; `verbs.py` handles negotiation, `Allow` and preconditions before it
calls them.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Hashable, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from typing import TypeAlias, TypeVar

from msgspec import Struct
from pyoxigraph import Triple
from starlette.responses import Response

from rosld.adapters.base import Watch
from rosld.adapters.model import RosError
from rosld.ontology.describe_graph import SECTIONS
from rosld.ontology.urls import Space
from rosld.server.auth.permissions import ALLOW_ALL, Permissions
from rosld.server.dataset.base import TripleChanges
from rosld.server.html.forms import Form
from rosld.server.html.page import Csrf, MemberColumns, Notice, Page, SequenceLink
from rosld.server.html.site import Site
from rosld.server.http.fields import Link, to_uri
from rosld.server.http.problem import Problem
from rosld.server.hypermedia.json_schema import MessageSchemas
from rosld.server.rest.exchange import Exchange
from rosld.server.rest.path_item import PathItem
from rosld.server.rest.ros_problems import problem_of
from rosld.server.rest.state import State
from rosld.server.storage.record import Write


class Motion(Struct, frozen=True):
    """A source of pictures: `watch` calls back when there may be a new one, `newest` returns it as a file.

    `newest` returns None if there is no new picture, or none can be drawn.
    """

    media_type: str
    watch: Callable[[Callable[[], None]], Awaitable[Watch]]
    newest: Callable[[], Awaitable[bytes | None]]


class RobotWrite(Struct, frozen=True):
    """A write to the robot with its description; `carry_out` performs it and returns whether it was received.

    `carry_out` raises RosError, and Problems if the robot declines.
    """

    description: str
    carry_out: Callable[[], Awaitable[bool]]


class StorageWrite(Struct, frozen=True):
    """Writes to the storage, applied in one transaction."""

    description: str
    writes: tuple[Write, ...]


Plan: TypeAlias = "RobotWrite | StorageWrite"


R = TypeVar("R", bound="Resource")
Find: TypeAlias = "Callable[[str], Resource]"
"""Function that returns the resource at a path below the base."""
READ = frozenset({"GET", "HEAD", "OPTIONS"})
ABSENT = frozenset({"OPTIONS"})
"""Methods of a missing resource that a write to its URL would not create."""
LDP = "http://www.w3.org/ns/ldp#"
CONFORMS_TO = "http://purl.org/dc/terms/conformsTo"
RESOURCE = Link(f"{LDP}Resource", "type")
RDF_SOURCE = Link(f"{LDP}RDFSource", "type")
BASIC_CONTAINER = Link(f"{LDP}BasicContainer", "type")


class Resource:
    """Base of all resources: read-only by default."""

    kind = "Resource"
    shape = ""
    """Name of the shape of its documents, in `/shapes/documents`, or the IRI of another one."""
    constraint = ""
    """Name of the shape of the bodies that it takes, below `/shapes/`, if that is always the same."""
    item: PathItem | None = None
    """Path item for `/openapi.json`, if it is constant."""
    links: tuple[Link, ...] = (RESOURCE, RDF_SOURCE)
    links_offer = False
    """Whether its responses link to its offer."""
    accepts: Mapping[str, Sequence[str]] = {}
    """Media types that PUT, POST and PATCH accept, by method."""
    in_turn: frozenset[str] = frozenset()
    """Methods whose outcome depends on the current state: such writes to one URL are serialized."""
    is_cacheable = True
    """Whether the path always leads to the same kind of resource."""
    passes_unknown_parameters: frozenset[str] = frozenset()
    """Methods that ignore undeclared query parameters, which otherwise cause a 400."""
    is_found_by_state = False
    """Whether only reading its state tells whether there is anything to GET."""
    takes_forms = True
    """Whether a posted form is a form of our pages (otherwise the resource reads it itself)."""
    has_own_formats = False
    """Whether `?format=` of a write names a format that the resource chooses itself."""
    title = ""
    """Heading of its page: usually a ROS name."""
    _permissions = ALLOW_ALL
    """Permissions that the state is limited to; ALLOW_ALL if `redact` limits it for an agent."""

    def __init__(self, space: Space, url: str) -> None:
        self.space = space
        self.url = url

    @property
    def variant_key(self) -> Hashable:
        """Identifier of a partial view (such as a page, or the view of one agent)."""
        return self._permissions.rights_key

    def __eq__(self, other: object) -> bool:
        """Whether the other resource has the same state, so that readers of changes can share it."""
        return (
            isinstance(other, Resource)
            and type(other) is type(self)
            and (other.url, other.variant_key) == (self.url, self.variant_key)
        )

    def __hash__(self) -> int:
        return hash((self.url, self.variant_key))

    async def prepare(self) -> None:
        """Read what the other methods need. Called first on each request."""

    @property
    def is_absent(self) -> bool:
        """Whether nothing exists at its URL and writes to it create nothing, as far as known without reading."""
        return False

    def methods(self) -> frozenset[str]:
        """Return the methods of the resource; `Allow` has them unless they are withheld or the resource is absent."""
        return READ

    @property
    def withheld(self) -> frozenset[str]:
        """Methods that are currently refused (423), because the robot is stopped."""
        return frozenset()

    async def current_methods(self) -> frozenset[str]:
        """Return the methods in the current state, which may have to be read: the answer to OPTIONS."""
        if not self.is_found_by_state:
            return ABSENT if self.is_absent else self.methods()
        try:
            await self.state()
        except (RosError, Problem) as error:  # other errors may be temporary, and do not mean that nothing exists
            problem = problem_of(error) if isinstance(error, RosError) else error
            if problem.status in (404, 410):
                return self.methods() - {"GET", "HEAD"}
        return self.methods()

    def path_item(self, schemas: MessageSchemas) -> PathItem:
        """Return the path item for `/openapi.json`; `schemas` collects those of messages."""
        return self.item or PathItem(self.kind)

    def deny_reason(self, method: str) -> str:
        """Return why a method is not allowed, in a sentence for a 405."""
        return f"{self.url} does not support {method}."

    @property
    def deny_about(self) -> Sequence[str]:
        """URLs of the other resources that `deny_reason` may mention."""
        return ()

    def not_allowed(self, method: str, status: int = 405) -> Problem:
        """Return the Problem of a method that is not allowed; 403 for a forbidden write of a graph."""
        headers = {"Allow": allow_field(self)} if status == 405 else {}
        return Problem(status, self.deny_reason(method), headers=headers, about=self.deny_about)

    async def state(self) -> State:
        """Return the current state. Raises a 404 (or 410) Problem if there is none."""
        raise NotImplementedError

    def redact(self, state: State, permissions: Permissions) -> State:
        """Return the state as seen by an agent with these permissions."""
        return state.redact(permissions)

    async def watch(self, wake: Callable[[], None]) -> Watch | None:
        """Call `wake` on the loop whenever the state may have changed, until the watch is closed.

        Wake-ups may be spurious: read the state again. After general changes (the graph, the mappings) the state is
        read and the watch is renewed anyway. None if there is no specific notification: the state is polled every few
        seconds.
        """
        return None

    async def forms(self) -> Sequence[Form]:
        """Return the forms on the page."""
        return ()

    @property
    def changes_subtree(self) -> bool:
        """Whether writes affect the subtree and therefore need permission for all of it."""
        return False

    @property
    def also_changes(self) -> Sequence[str]:
        """URLs of other resources that a write changes, and so needs permission for."""
        return ()

    @property
    def conforms_to(self) -> Sequence[str]:
        """URLs of the shapes of the document."""
        if not self.shape:
            return ()
        return (self.shape if "/" in self.shape else self.space.document_shape(self.shape),)

    @property
    def constrained_by(self) -> str | None:
        """URL of the constraints on request bodies, such as the shape of its type."""
        return self.space.shape(self.constraint) if self.constraint else None

    def page(
        self, site: Site, state: State, forms: Sequence[Form], csrf: Csrf, notices: Sequence[Notice]
    ) -> Page | bytes:
        """Return its page, already rendered if it has its own template."""
        return Page(
            site,
            self.kind,
            _heading(self.title, self.url.removeprefix(site.base).partition("?")[0]),
            state.document,
            tuple(sorted(each for each in self.methods() - self.withheld if self._is_for(site, each))),
            tuple(forms),
            csrf,
            tuple(notices),
            self.listing(),
            self.navigation_links(),
            offer=state.view,
            query=self.query,
        )

    def _is_for(self, site: Site, method: str) -> bool:
        """Whether the reader of a page may use a method of this resource."""
        if method in READ or not site.is_restricted:
            return site.may(method, self.url)
        may = all(site.may(method, url) for url in (self.url, *self.also_changes))
        return may and (not self.changes_subtree or site.may_subtree(method, self.url))

    @property
    def query(self) -> str:
        """Query string of a variant, such as a page of a container."""
        return self.url.partition("?")[2]

    def listing(self) -> MemberColumns | None:
        """Return the columns of members on the page."""
        return None

    def navigation_links(self) -> tuple[SequenceLink, ...]:
        """Return the neighbours that its page links to."""
        return ()

    def variant(self: R, **changes: object) -> R:
        """Return a copy with other values of some attributes, such as a page or a selection."""
        copy = object.__new__(type(self))
        copy.__dict__.update(self.__dict__, **changes)
        return copy

    async def select_variant(self, exchange: Exchange) -> Resource:
        """Return the resource that query and preferences select: a page of this one, a variant, or itself."""
        return self

    def streams_body(self, exchange: Exchange) -> bool:
        """Whether a write reads its body incrementally, because it may be larger than memory."""
        return False

    def keep_alive(self, exchange: Exchange) -> AbstractContextManager[float | None]:
        """Return the context of an event stream of changes. May raise Problems, but not on entry.

        Its value is the interval of keep-alive comments in seconds, None for the default.
        """
        return nullcontext()

    async def custom_get(self, exchange: Exchange) -> Response | Motion | None:
        """Return a response other than a representation of the resource, such as the bytes of one field."""
        return None

    async def plan_graph_change(self, change: TripleChanges) -> Plan | None:
        """Plan a small change of a large graph; None if the plan needs the whole graph.

        Raises as `plan_graph_write`.
        """
        return None

    async def plan_graph_write(self, triples: Sequence[Triple] | None) -> Plan:
        """Plan to replace the graph by these triples, or to delete it (None).

        All checks are done, but nothing is changed. Raises Problems (403 if it is never writable), LoweringError for
        triples that do not fit, and RosError.
        """
        raise self.not_allowed("PUT", 403)

    async def put(self, exchange: Exchange) -> Answer:
        """Handle a PUT (RFC 9110 9.3.4); called only while it is among `methods()`.

        Raises Problems (405 unless overridden), BodyError, LoweringError and RosError, as do the other three methods.
        """
        raise self.not_allowed("PUT")

    async def post(self, exchange: Exchange) -> Answer:
        """Handle a POST (RFC 9110 9.3.3). Raises as `put`."""
        raise self.not_allowed("POST")

    async def patch(self, exchange: Exchange) -> Answer:
        """Handle a PATCH (RFC 5789). Raises as `put`."""
        raise self.not_allowed("PATCH")

    async def delete(self, exchange: Exchange) -> Answer:
        """Handle a DELETE (RFC 9110 9.3.5). Raises as `put`."""
        raise self.not_allowed("DELETE")


class CreatedAnswer(Struct, frozen=True):
    """A created resource: answered as 201 with its location and, as body, its state if there is one."""

    location: str
    resource: Resource
    state: State | None
    links: tuple[Link, ...] = ()


class ShownAnswer(Struct, frozen=True):
    """A resource that shows the outcome of a write: answered as 200 with its state and its Content-Location."""

    resource: Resource
    state: State
    links: tuple[Link, ...] = ()


Answer: TypeAlias = Response | CreatedAnswer | ShownAnswer
"""Answer to a write: a finished response, or a resource still to be represented as the request prefers."""


def _heading(title: str, path: str) -> str:
    """Return the heading of the page at a path below the base; top-level containers have fixed ones."""
    route, slash, rest = path.partition("/")
    return SECTIONS.get(route, route.capitalize()) if slash and not rest else title or path


def permanent_redirect(url: str) -> Problem:
    """Return the 308 to `url` (RFC 9110 15.4.9)."""
    return Problem(308, f"It is at {url}", title="Moved", headers={"Location": to_uri(url)})


def allow_field(resource: Resource) -> str:
    """Return the Allow field of a resource."""
    return ", ".join(sorted(ABSENT if resource.is_absent else resource.methods() - resource.withheld))
