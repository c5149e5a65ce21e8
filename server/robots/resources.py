"""Resources at the base of a server of several robots: `/robots/`, the stop, the search and the faults of all."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from functools import partial
from typing import TYPE_CHECKING

import orjson
from msgspec.structs import replace
from pyoxigraph import NamedNode
from starlette.responses import Response

from rosld.adapters.model import RosError
from rosld.ontology.body import parse_json
from rosld.ontology.triples import text, triples_about
from rosld.ontology.urls import Location, Space
from rosld.ontology.vocab import dcterms, rdfs, ros
from rosld.server.auth.permissions import ALLOW_ALL, Permissions
from rosld.server.html.forms import DeleteForm, Form
from rosld.server.html.page import Cell, Csrf, MemberColumns, Notice, NoticeLevel, Page
from rosld.server.html.site import Site
from rosld.server.http.fields import Link
from rosld.server.http.problem import Problem
from rosld.server.hypermedia.brief_value import LatestValue
from rosld.server.hypermedia.json_schema import BOOLEAN, TEXT, URI, JsonSchema, json_array, json_object, nullable
from rosld.server.openapi.openapi_resource import OpenApiResource
from rosld.server.resources.entry_point import GuideResource
from rosld.server.resources.faults import faults_listing
from rosld.server.resources.find import FindResource
from rosld.server.resources.listings import ListedMember, ListingResource
from rosld.server.resources.stop import StopResource
from rosld.server.rest.exchange import Exchange
from rosld.server.rest.formats import JSON
from rosld.server.rest.path_item import PathItem, WriteMethod
from rosld.server.rest.resource import READ, Answer, CreatedAnswer, Resource
from rosld.server.rest.state import State
from rosld.server.routing.router import Route, single_route
from rosld.server.search.index import Entry, SearchResults
from rosld.server.search.words import Query

if TYPE_CHECKING:
    from rosld.server.app import Parts
    from rosld.server.resources.base import Services
    from rosld.server.robots.robots import Robot, Robots

_KEPT = frozenset(
    {
        ".well-known", "acl", "activity", "channels", "data", "docs", "healthz", "metrics", "ontology", "openapi.json",
        "queries", "readyz", "shapes", "sparql", "status", "types",
    }
)  # fmt: skip
"""Routes that mean the same at the base as at a robot."""
_DESCRIBED = (
    "/robots/", "/stop", "/find", "/faults/", "/sparql", "/status", "/activity/", "/data/", "/queries/", "/channels/",
    "/channels/StreamingHTTPChannel2023", "/channels/WebSocketChannel2023", "/docs/", "/ontology", "/openapi.json",
    "/llms.txt", "/metrics",
)  # fmt: skip
_ROBOT: JsonSchema = json_object(
    {"name": TEXT, "url": URI, "source": TEXT, "state": {"enum": ["Live", "Stale"]}},
    {"stopped": BOOLEAN, "reason": nullable(TEXT), "cockpit": URI, "stop": URI},
)
_SENDS: JsonSchema = json_object({"name": TEXT, "source": TEXT})


def routes(robots: Robots, parts: Parts) -> Mapping[str, Route]:
    """Return the routes at the base, by the first segment of the path."""
    router, services, space = parts.router, parts.services, robots.session.space
    listing = partial(RobotsResource, robots, parts)
    openapi = router.at("/openapi.json")
    assert isinstance(openapi, OpenApiResource)
    openapi.only = {path: path for path in _DESCRIBED}
    find = FindInAll(robots, parts.services)

    def entry() -> Resource:
        url = space.container("robots")
        raise Problem(307, f"The robots are at {url}", title="Moved", headers={"Location": url})

    def below(location: Location) -> Resource:
        if not location.segments:
            return listing() if location.is_container else entry()
        robot = robots.get(location.segments[0])
        if robot is None:
            raise Problem(404, f"There is no robot {location.segments[0]}: see {space.container('robots')}")
        if len(location.segments) == 1:
            return RobotResource(robots, robot)
        robot.require()
        raise Problem(404, f"Ask the robot itself, below {robot.url} (without percent-encoding).")

    def faults(location: Location) -> Resource:
        if location.segments:
            raise Problem(404, f"Each fault is at its robot: see {space.container('faults')}")
        columns = ("state", "severity", "words", "count", "last")
        title = "The faults of all robots"
        members = partial(_faults, robots)
        return ListingResource(services, "faults", title, columns, members, robots.changes)

    return {
        **{name: route for name, route in router.routes.items() if name in _KEPT or "." in name},
        "": single_route(entry),
        "robots": below,
        "cockpit": lambda location: entry(),
        "faults": faults,
        "find": single_route(lambda: find),
        "stop": single_route(partial(StopAllResource, services)),
        "llms.txt": single_route(partial(RobotsGuide, space, services.session.name)),
    }


def _faults(robots: Robots) -> Iterable[ListedMember]:
    """Yield the faults of all robots, labelled with the names of their robots."""
    for robot in robots:
        if robot.app is not None:
            for each in faults_listing(robot.app.parts.services).members():
                yield replace(each, name=f"{robot.name}: {each.name}")


class FindInAll(FindResource):
    """The search of all connected robots, best results first."""

    def __init__(self, robots: Robots, services: Services) -> None:
        super().__init__(services, self)
        self._robots = robots

    async def values(self, entries: Sequence[Entry]) -> Mapping[str, LatestValue]:
        """Return the latest values by URL, of all robots at once."""

        async def read(robot: Robot) -> Mapping[str, LatestValue]:
            own = [each for each in entries if each.url.startswith(robot.url)]
            if not own or robot.app is None:
                return {}
            return await robot.app.parts.router.search.variant(_subscribes=self._subscribes).values(own)

        found = await asyncio.gather(*map(read, self._robots), return_exceptions=True)
        return {url: value for each in found if not isinstance(each, BaseException) for url, value in each.items()}

    async def find(self, query: Query, permissions: Permissions, limit: int) -> SearchResults:
        """Return at most `limit` readable entries."""
        found = []
        for app in [each.app for each in self._robots if each.app is not None]:
            with suppress(RosError):  # a robot that has just gone
                found.append(await app.parts.router.search.finder.find(query, permissions, limit))
        return SearchResults.merge(found, query, limit)


class StopAllResource(StopResource):
    """The stop of all robots: POST stops each of them, and each is released at its own stop."""

    def methods(self) -> frozenset[str]:
        return super().methods() - {"DELETE"}

    def path_item(self, schemas: object) -> PathItem:
        item = super().path_item(schemas)  # type: ignore[arg-type]
        return replace(item, summary="The stop of all robots", writes={"POST": item.writes["POST"]})

    def deny_reason(self, method: str) -> str:
        if method == "DELETE":
            return "Each robot is released at its own stop, by a person who sees it: follow the steps."
        return super().deny_reason(method)

    async def forms(self) -> Sequence[Form]:
        return [form for form in await super().forms() if form.method == "POST"]


class RobotsGuide(GuideResource):
    """The guide to several robots for language models."""

    def __init__(self, space: Space, name: str) -> None:
        super().__init__(space, name, read_only=True)
        self._data = f"""# {name}

> Several robots (ROS), each a web site of its own below {space.container("robots")}.

Send `Accept: application/json`. Read the list of robots, then the guide of one: `llms.txt` below its URL.

- [Robots]({space.container("robots")}): name, URL, state and source of each
- [Find]({space.base}find?q=battery): in all robots by words
- [Faults]({space.container("faults")}): of all robots
- [SPARQL]({space.base}sparql): queries over all robots; an update reaches the robot whose URL it names
- [Stop]({space.stop}): POST stops all robots at once; each is released at its own stop
""".encode()


class RobotsResource(ListingResource):
    """`/robots/`: every robot with its state; POST adds one."""

    accepts: Mapping[str, Sequence[str]] = {"POST": (JSON,)}

    def __init__(self, robots: Robots, parts: Parts) -> None:
        columns = ("state", "source", "faults", "cockpit", "stop")
        members = partial(map, _member, robots)
        super().__init__(parts.services, "robots", "The robots", columns, members, robots.changes)
        self._robots = robots
        base = robots.session.space.base
        self.links = (
            *self.links,
            Link(f"{base}openapi.json", "service-desc", type="application/openapi+json"),
            Link(f"{base}find", "search"),
            Link(f"{base}llms.txt", "help", type="text/plain"),
        )

    def path_item(self, schemas: object) -> PathItem:
        note = "Adds a robot, whose source is opened in the background. A server with --data keeps it over a restart."
        post = WriteMethod(note, _SENDS)
        return PathItem("The robots", plain=json_array(_ROBOT), writes={"POST": post})

    def methods(self) -> frozenset[str]:
        return READ if self._robots.settings.read_only else READ | {"POST"}

    async def state(self) -> State:
        return replace(await super().state(), plain=partial(self._plain_for, ALLOW_ALL))

    def redact(self, state: State, permissions: Permissions) -> State:
        return state.redact(permissions, plain=partial(self._plain_for, permissions))

    def _plain_for(self, permissions: Permissions) -> bytes:
        found = []
        for robot in self._robots:
            more = {"cockpit": f"{robot.url}cockpit/default", "stop": f"{robot.url}stop"}
            if permissions.may_read(robot.url):
                own = {"name": robot.name, "url": robot.url, "source": robot.shown_source, "state": _state(robot)}
                readable = {name: url for name, url in more.items() if permissions.may_read(url)}
                stopped = {"stopped": _is_stopped(robot)} if "stop" in readable else {}
                found.append({**own, **stopped, "reason": robot.trouble, **readable})
        return orjson.dumps(found)

    async def forms(self) -> Sequence[Form]:
        about = "It publishes zero on velocity topics, ends holds, cancels goals and refuses all writes but zero."
        apps = [(each.name, each.url, each.app) for each in self._robots if each.app is not None]
        return [
            DeleteForm(f"Stop {name}", f"Stop {name}", about, f"{url}stop", method="POST")
            for name, url, app in apps
            if app.parts.services.software_stop.is_usable
        ]

    def page(
        self, site: Site, state: State, forms: Sequence[Form], csrf: Csrf, notices: Sequence[Notice]
    ) -> Page | bytes:
        allowed = [each for each in forms if site.may("POST", each.action)]
        if (lost := self._robots.added.lost_at_end) and site.may("POST", self.url):
            sentence = f"{', '.join(lost)}: added here, and gone after a restart of the server. --data DIR keeps them."
            notices = [*notices, Notice(sentence, NoticeLevel.WARNING)]
        found = super().page(site, state, allowed, csrf, notices)
        assert isinstance(found, Page)
        return replace(found, listing=self._listing_for(site))

    def _listing_for(self, site: Site) -> MemberColumns:
        """Return the columns without states and faults that the reader may not read."""
        members = (_member(robot, site.may) for robot in self._robots)
        return replace(self.listing(), cells={each.url: each.cells for each in members})

    async def post(self, exchange: Exchange) -> Answer:
        """Add a robot: 201. Raises Problems: 403 for a recording, 409 for a used name, 422 for an invalid source."""
        match parse_json(await exchange.body()):
            case {"name": str(name), "source": str(source), **others} if not others:
                exchange.audit.add_step(f"add the robot {name[:64]}", self.url)
                try:
                    robot = await self._robots.add(name, source)
                except ValueError as error:
                    raise Problem(422, f"{error}.") from error
                return CreatedAnswer(robot.url, RobotResource(self._robots, robot), None)
        raise Problem(422, 'The body must be {"name": "...", "source": "..."}.')


def _state(robot: Robot) -> str:
    return "Live" if robot.trouble is None else "Stale"


def _is_stopped(robot: Robot) -> bool:
    return (robot.stop_state if robot.app is None else robot.app.session.interlock.stop_state) is not None


def _member(robot: Robot, may: Callable[[str, str], bool] = lambda method, url: True) -> ListedMember:
    """Return the robot as a member of `/robots/`, with cells for a reader with these permissions."""
    node, trouble, state = NamedNode(robot.url), robot.trouble, _state(robot)
    faults = () if robot.app is None else robot.app.parts.services.faults.all()
    active = str(sum(not each.is_healed for each in faults)) if may("GET", f"{robot.url}faults/") else ""
    is_stopped = may("GET", f"{robot.url}stop") and _is_stopped(robot)
    shown = "stopped" if is_stopped else "live" if trouble is None else f"unreachable: {trouble}"
    cells: tuple[Cell, ...] = (shown, robot.shown_source, active, NamedNode(f"{robot.url}cockpit/default"))
    outline = triples_about(
        node,
        (rdfs.label, text(robot.name)),
        (ros.state, ros.terms[state]),
        (ros.reason, None if trouble is None else text(trouble)),
        (dcterms.source, text(robot.shown_source)),
        (ros.hasStop, NamedNode(f"{robot.url}stop")),
        (rdfs.seeAlso, NamedNode(f"{robot.url}cockpit/default")),
    )
    return ListedMember(
        robot.url, robot.name, (*cells, NamedNode(f"{robot.url}stop")), tuple(outline), trouble is not None
    )


class RobotResource(Resource):
    """One robot, as far as the base is concerned: DELETE removes it."""

    kind = "Robot"
    item = PathItem(
        "A robot: an entry point with everything below it, as if it were alone",
        writes={"DELETE": WriteMethod("Removes the robot from this server.", done=(204,))},
    )
    is_cacheable = False

    def __init__(self, robots: Robots, robot: Robot) -> None:
        super().__init__(robots.session.space, robot.url)
        self._robots = robots
        self._robot = robot

    def methods(self) -> frozenset[str]:
        return READ if self._robots.settings.read_only else READ | {"DELETE"}

    async def state(self) -> State:
        """Return the state of its entry point. Raises a 503 Problem while it is not connected."""
        return await self._robot.require().parts.router.at("/").state()

    async def delete(self, exchange: Exchange) -> Answer:
        """Remove the robot: 204."""
        exchange.audit.add_step(f"remove the robot {self._robot.name}", self.url)
        await self._robots.remove(self._robot.name)
        return Response(status_code=204)
