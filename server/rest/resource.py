"""Base class of resources: everything that has a URL.

A resource is made for a request and holds no state of its own: `state()` tells what it is like now. Verbs it lists in
`methods` are its coroutines of the same names; `verbs.py` has done negotiation, `Allow` and preconditions before them.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Hashable, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from typing import TypeAlias, TypeVar

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


@dataclass(frozen=True, slots=True)
class Motion:
    """A source of pictures: `watch` calls back whenever there may be a new one, `newest` gives it as a file.

    `newest` gives None where there is none that was not given before, or none can be drawn.
    """

    media_type: str
    watch: Callable[[Callable[[], None]], Awaitable[Watch]]
    newest: Callable[[], Awaitable[bytes | None]]


@dataclass(frozen=True, slots=True)
class RobotWrite:
    """A write to the robot: `does` describes it, `carry_out` performs it and returns whether it was received.

    `carry_out` raises RosError, and Problems where the robot declines.
    """

    description: str
    carry_out: Callable[[], Awaitable[bool]]


@dataclass(frozen=True, slots=True)
class StorageWrite:
    """Writes to the storage, done together in one transaction."""

    description: str
    writes: tuple[Write, ...]


Plan: TypeAlias = "RobotWrite | StorageWrite"


R = TypeVar("R", bound="Resource")
READ = frozenset({"GET", "HEAD", "OPTIONS"})
ABSENT = frozenset({"OPTIONS"})
"""What is answered of what is not there, and is not made by a write to its URL."""
LDP = "http://www.w3.org/ns/ldp#"
CONFORMS_TO = "http://purl.org/dc/terms/conformsTo"
RESOURCE = Link(f"{LDP}Resource", "type")
RDF_SOURCE = Link(f"{LDP}RDFSource", "type")
BASIC_CONTAINER = Link(f"{LDP}BasicContainer", "type")


class Resource:
    """Base of all resources: readable, nothing else."""

    kind = "Resource"
    shape = ""
    """The name of the shape of its documents, in `/shapes/documents`."""
    item: PathItem | None = None
    """Its path item for `/openapi.json`, if that is always the same."""
    links: tuple[Link, ...] = (RESOURCE, RDF_SOURCE)
    accepts: Mapping[str, Sequence[str]] = {}
    """The media types that PUT, POST and PATCH take, by method."""
    in_turn: frozenset[str] = frozenset()
    """The methods whose outcome depends on what is there: such writes of one URL are carried out in turn."""
    is_cacheable = True
    """Whether the same path means the same kind of resource for ever."""
    passes_unknown_parameters: frozenset[str] = frozenset()
    """The methods that pass over query parameters that nobody declares, which are 400 elsewhere."""
    takes_forms = True
    """Whether a posted form is one of our pages' (else the resource reads it itself)."""
    title = ""
    """What its page is called: a ROS name as a rule."""
    _permissions = ALLOW_ALL
    """The permissions that the state was made for; ALLOW_ALL if `redact` removes from it what an agent may not see."""

    def __init__(self, space: Space, url: str) -> None:
        self.space = space
        self.url = url

    @property
    def variant_key(self) -> Hashable:
        """Identifier of a partial view of the URL's state: a page, some parts, or what one agent may see."""
        return self._permissions.rights_key

    def __eq__(self, other: object) -> bool:
        """Whether the other resource has the same state, so that those who wait for changes can share it."""
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
        """Whether there is nothing at its URL, and no write to it would make something, as far as is known unread."""
        return False

    def methods(self) -> frozenset[str]:
        """Return the verbs it answers; what `Allow` says but for those withheld, unless it is absent."""
        return READ

    @property
    def withheld(self) -> frozenset[str]:
        """The verbs that are refused for now, though it answers them: 423, because the robot is stopped."""
        return frozenset()

    async def current_methods(self) -> frozenset[str]:
        """Return the verbs it answers in its present state, which may have to be read: what OPTIONS says."""
        return ABSENT if self.is_absent else self.methods()

    async def methods_if_there(self) -> frozenset[str]:
        """Return the methods of the current state, if there is anything to GET."""
        try:
            await self.state()
        except (RosError, Problem) as error:  # another one may pass, and tells nothing of what is there
            problem = problem_of(error) if isinstance(error, RosError) else error
            if problem.status in (404, 410):
                return self.methods() - {"GET", "HEAD"}
        return self.methods()

    def path_item(self, schemas: MessageSchemas) -> PathItem:
        """Return the path item for `/openapi.json`; `schemas` collects those of messages."""
        return self.item or PathItem(self.kind)

    def deny_reason(self, method: str) -> str:
        """Why a verb is not allowed, in a sentence for a 405."""
        return f"{self.kind} resources do not answer {method}."

    @property
    def deny_about(self) -> Sequence[str]:
        """The URLs of the other resources that `deny_reason` may name."""
        return ()

    def not_allowed(self, method: str, status: int = 405) -> Problem:
        """Return the Problem of a verb that is not allowed; 403 where what is not allowed is a write of the graph."""
        headers = {"Allow": allow_field(self)} if status == 405 else {}
        return Problem(status, self.deny_reason(method), headers=headers, about=self.deny_about)

    async def state(self) -> State:
        """Return the current state. Raises a 404 (or 410) Problem if there is none."""
        raise NotImplementedError

    def redact(self, state: State, permissions: Permissions) -> State:
        """Return its state as an agent may see it who may not know of everything."""
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
        """Whether its writes change what lies below it, too, so that they take the right to all of that."""
        return False

    @property
    def also_changes(self) -> Sequence[str]:
        """Return the URLs of other resources that a write changes, and so needs permission for."""
        return ()

    @property
    def conforms_to(self) -> Sequence[str]:
        """The URLs of the shapes of the document."""
        return (self.space.document_shape(self.shape),) if self.shape else ()

    @property
    def constrained_by(self) -> str | None:
        """The URL of what constrains the bodies it takes, such as the shape of its type."""
        return None

    def page(
        self, site: Site, state: State, forms: Sequence[Form], csrf: Csrf, notices: Sequence[Notice]
    ) -> Page | bytes:
        """Return its page for people, rendered already where it has a template of its own."""
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
        """The query string of a variant, such as one page of several."""
        return self.url.partition("?")[2]

    def listing(self) -> MemberColumns | None:
        """Return the columns of members on the page."""
        return None

    def navigation_links(self) -> tuple[SequenceLink, ...]:
        """Return the neighbours that its page links to."""
        return ()

    def variant(self: R, **changes: object) -> R:
        """Return a copy with other values of some attributes, such as a page or a selection."""
        made = object.__new__(type(self))
        made.__dict__.update(self.__dict__, **changes)
        return made

    async def select_variant(self, exchange: Exchange) -> Resource:
        """Return the resource that query and preferences ask for: a page of this one, a variant, itself."""
        return self

    def streams_body(self, exchange: Exchange) -> bool:
        """Whether a write reads its body itself, as it comes, because it may be larger than memory."""
        return False

    def keep_alive(self, exchange: Exchange) -> AbstractContextManager[float | None]:
        """Return the context of an event stream of changes. Raises Problems; entering it raises nothing.

        Its value is the interval of keep-alive comments in seconds, None for the default.
        """
        return nullcontext()

    async def custom_get(self, exchange: Exchange) -> Response | Motion | None:
        """Return a response that is no representation of the whole, such as the bytes of one field."""
        return None

    async def plan_graph_change(self, change: TripleChanges) -> Plan | None:
        """Plan a small change of a large graph; None if the plan needs the whole graph.

        Raises as `plan_graph_write`.
        """
        return None

    async def plan_graph_write(self, triples: Sequence[Triple] | None) -> Plan:
        """Plan to make the graph exactly these triples, or to delete it (None).

        Everything that can be refused is, and nothing moves. Raises Problems (403 if it is never writable),
        LoweringError for what does not fit, and RosError.
        """
        raise self.not_allowed("PUT", 403)

    async def put(self, exchange: Exchange) -> Answer:
        """Carry out a PUT (RFC 9110 9.3.4), which is called only while it is among `methods()`.

        Raises Problems (405 unless overridden), BodyError, LoweringError and RosError; so do the other three verbs.
        """
        raise self.not_allowed("PUT")

    async def post(self, exchange: Exchange) -> Answer:
        """Carry out a POST (RFC 9110 9.3.3); raises as `put`."""
        raise self.not_allowed("POST")

    async def patch(self, exchange: Exchange) -> Answer:
        """Carry out a PATCH (RFC 5789); raises as `put`."""
        raise self.not_allowed("PATCH")

    async def delete(self, exchange: Exchange) -> Answer:
        """Carry out a DELETE (RFC 9110 9.3.5); raises as `put`."""
        raise self.not_allowed("DELETE")


@dataclass(frozen=True, slots=True)
class CreatedAnswer:
    """A resource that a write made: answered as 201 with its location and, as body, its state if there is one."""

    location: str
    resource: Resource
    state: State | None
    links: tuple[Link, ...] = ()


@dataclass(frozen=True, slots=True)
class ShownAnswer:
    """A resource that shows what became of a write: answered as 200 with its state and its Content-Location."""

    resource: Resource
    state: State
    links: tuple[Link, ...] = ()


Answer: TypeAlias = Response | CreatedAnswer | ShownAnswer
"""What a write answers: a finished response, or a resource still to be represented as the request prefers."""


def _heading(title: str, path: str) -> str:
    """Return the heading of the page at a path below the base: the own name of a top-level container."""
    route, slash, rest = path.partition("/")
    return SECTIONS.get(route, route.capitalize()) if slash and not rest else title or path


def permanent_redirect(url: str) -> Problem:
    """Return 308: the resource is at `url` (RFC 9110 15.4.9)."""
    return Problem(308, f"It is at {url}", title="Moved", headers={"Location": to_uri(url)})


def allow_field(resource: Resource) -> str:
    """Return the Allow field of a resource."""
    return ", ".join(sorted(ABSENT if resource.is_absent else resource.methods() - resource.withheld))
