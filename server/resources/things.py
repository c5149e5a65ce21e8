"""Thing Descriptions (WoT TD 1.1); large ones are split into parts, each with a link to the next."""

from __future__ import annotations

from collections.abc import Container, Iterator, Mapping, Sequence
from typing import TypeAlias
from urllib.parse import urljoin

import orjson
from msgspec import Struct
from msgspec.structs import replace
from starlette.responses import Response

from rosld.ontology.serialize import serialize
from rosld.ontology.urls import Space
from rosld.server.auth.authenticator import UNRESTRICTED
from rosld.server.auth.permissions import ALLOW_ALL, Permissions
from rosld.server.auth.redaction import redact_thing_description
from rosld.server.http.conditional import ETag, digest
from rosld.server.http.negotiation import choose_offer
from rosld.server.hypermedia.affordance_service import AffordanceService
from rosld.server.hypermedia.conditions import url_of
from rosld.server.hypermedia.json_schema import OBJECT
from rosld.server.hypermedia.resource_tree import ComplexPlan, ResourceTree
from rosld.server.hypermedia.thing_description import MEDIA_TYPE, ThingLink, thing_description, thing_document
from rosld.server.hypermedia.views import ActionAffordance, PropertyAffordance
from rosld.server.rest.exchange import Exchange
from rosld.server.rest.formats import RDF_BODIES, VARIANTS
from rosld.server.rest.path_item import MAX_PART, PART_QUERY, PUNCTUATION, PathItem, cut_parts, parse_part, part_url
from rosld.server.rest.resource import RESOURCE, Resource
from rosld.server.rest.responses import bytes_response
from rosld.server.rest.state import State
from rosld.server.robot.diagnostic_states import has_diagnostics
from rosld.server.robot.session import Session
from rosld.server.robot.software_stop import SoftwareStop

_Affordance: TypeAlias = "Mapping[str, object]"
_KINDS = ("properties", "actions", "events")
_OF_THE_GRAPH = frozenset({"topics", "services", "actions", "parameters"})
_FRAME = 600
"""Bytes reserved for links to the whole and to the next part."""


_NOTHING: Mapping[str, int] = {}


def add_part_link(data: bytes, url: str) -> bytes:
    """Return a description that links to its first part, if it has several; `url` is its own."""
    if len(data) <= MAX_PART:
        return data
    thing = orjson.loads(data)
    return orjson.dumps({**thing, "links": [*thing["links"], _link("section", part_url(url, "/"))]})


def thing_parts(data: bytes, base: str, url: str, below: str) -> tuple[bytes, ...]:
    """Return the parts of the description at `url` with the affordances at paths below `base` that begin with `below`.

    Empty if there are no such affordances.
    """
    thing = orjson.loads(data)
    affordances = [
        (kind, name, one)
        for kind in _KINDS
        for name, one in thing.get(kind, {}).items()
        if _is_below(one, thing["id"], base, below)
    ]
    head = {**{name: each for name, each in thing.items() if name not in _KINDS}, "links": [_link("collection", url)]}
    room = MAX_PART - len(orjson.dumps(head)) - 2 * len(url) - 3 * len(below) - _FRAME
    sized = (
        (one, len(orjson.dumps(one[2])) + len(orjson.dumps(one[1])) + PUNCTUATION, _NOTHING) for one in affordances
    )
    parts = tuple(cut_parts(sized, room))
    return tuple(
        orjson.dumps(
            {
                **head,
                **{kind: {name: one for own, name, one in part if own == kind} for kind in _KINDS},
                "links": [
                    *head["links"],
                    *([_link("next", part_url(url, below, number))] if number < len(parts) else ()),
                ],
            }
        )
        for number, part in enumerate(parts, 1)
    )


def _is_below(affordance: _Affordance, own: str, base: str, below: str) -> bool:
    """Whether a form of an affordance leads to a path below `base` that begins with `below`.

    The paths of topics, services, actions and parameters stand for those of the resources of the same names.
    """
    forms = affordance["forms"]
    assert isinstance(forms, list)
    asked = base.rstrip("/") + below
    route, slash, rest = below[1:].partition("/")
    found = (asked, f"{base}resources/{rest}") if slash and route in _OF_THE_GRAPH else (asked,)
    return any(urljoin(own, form["href"]).startswith(found) for form in forms)


def _link(relation: str, target: str) -> dict[str, str]:
    """Return a link to a Thing Description (RFC 6573, RFC 8288)."""
    return {"rel": relation, "href": target, "type": "application/td+json"}


FORMAT = "td"
_OFFERS = (*RDF_BODIES, "application/json", "text/html", MEDIA_TYPE)


def wants_thing(exchange: Exchange) -> bool:
    """Whether a request prefers a Thing Description to the state."""
    return exchange.preferred({FORMAT: MEDIA_TYPE}, _OFFERS) == MEDIA_TYPE


class ThingDescriptions(Struct, eq=False):
    """Generator of the Thing Descriptions of complex resources and of the whole robot, and of responses with them."""

    session: Session
    affordances: AffordanceService[State]
    software_stop: SoftwareStop
    instance_id: str
    """Part of the entity tags, which differs between runs of the server."""

    def response(self, exchange: Exchange, url: str, own: str, data: bytes) -> Response:
        """Return the response with a Thing Description, or a part of it, redacted, in the requested syntax.

        `url` is the URL of the responding resource, `own` that of the description.
        """
        if exchange.auth is not UNRESTRICTED:
            scheme = (exchange.header("authorization") or "").partition(" ")[0]
            data = redact_thing_description(data, exchange.permissions, scheme)
        part = parse_part(exchange.query, self.session.space.base)
        if part is None:
            data = add_part_link(data, own)
        else:
            data = part.choose(thing_parts(data, self.session.space.base, own, part.below))
        tag, media_type = f"{self.instance_id}-{digest(data)}", _choose_syntax(exchange)
        if media_type == MEDIA_TYPE:
            return bytes_response(exchange, data, MEDIA_TYPE, ETag(tag, FORMAT))
        written = serialize(thing_document(data, url), media_type)
        return bytes_response(exchange, written, media_type, ETag(tag, f"{FORMAT}-{VARIANTS[media_type]}"))

    def of_complex(self, plan: ComplexPlan) -> bytes:
        """Return the Thing Description of a complex resource: everything it can ever offer."""
        properties, actions = self._of_members(plan)
        space = self.session.space
        up = () if plan.parent is None else (ThingLink("collection", url_of(plan.parent, space)),)
        down = tuple(ThingLink("item", url_of(child.path, space)) for child in plan.children)
        related = tuple(ThingLink(link.relation.value, url_of(link.target, space)) for link in plan.links)
        title = (plan.mapped.title if plan.mapped else None) or plan.path
        return thing_description(
            title,
            url_of(plan.path, space),
            properties,
            actions,
            links=(*related, *up, *down),
            whole=bool(properties),
            stop=space.stop if self.software_stop.is_usable else None,
            lifting=self.session.lifting,
        )

    def of_robot(self, tree: ResourceTree, permissions: Permissions = ALLOW_ALL) -> bytes:
        """Return the Thing Description of the robot: the affordances of all complex resources, named by path.

        Includes actions that no complex resource lists. For a complex resource that the agent may not read, it includes
        the properties under their own URLs.
        """
        properties: list[PropertyAffordance] = []
        actions: list[ActionAffordance] = []
        links: list[ThingLink] = []
        for path in sorted(tree.paths):
            plan = tree.complex(path)
            assert plan is not None
            own, acts = self._of_members(plan)
            if permissions.may_read(url_of(path, self.session.space)):
                properties += (replace(one, name=path[1:] + one.name) for one in own)
            else:
                properties += self._by_themselves(tree, plan)
            actions += (replace(one, name=path[1:] + one.name) for one in acts)
            if own or acts:
                links.append(ThingLink("item", url_of(path, self.session.space)))
        actions += self._unlisted_actions(tree, {one.url for one in actions})
        system = self.session.adapter.capabilities.system
        return thing_description(
            self.session.name,
            self.session.space.base,
            properties,
            actions,
            links=links,
            description=system,
            stop=self.session.space.stop if self.software_stop.is_usable else None,
            diagnostics=f"{self.session.space.base}diagnostics" if has_diagnostics(self.session.graph) else None,
            lifting=self.session.lifting,
        )

    def _of_members(self, plan: ComplexPlan) -> tuple[Sequence[PropertyAffordance], Sequence[ActionAffordance]]:
        offers = self.affordances
        properties = tuple(offers.member_affordance(one, write=True) for one in plan.members)
        return properties, tuple(map(offers.action_affordance, plan.actions))

    def _unlisted_actions(self, tree: ResourceTree, listed: Container[str]) -> Iterator[ActionAffordance]:
        """Yield the actions that no complex resource lists because a mapping omits them."""
        for name in sorted(tree.actions):
            plan = tree.action(name)
            if plan is not None and (affordance := self.affordances.action_affordance(plan)).url not in listed:
                yield replace(affordance, name=name[1:])

    def _by_themselves(self, tree: ResourceTree, plan: ComplexPlan) -> Iterator[PropertyAffordance]:
        """Yield the members of a complex resource as described at their own URLs."""
        for name in (member.url_name for member in plan.members if member.url_name is not None):
            own = tree.property(name)
            if own is not None:
                yield replace(self.affordances.member_affordance(own.member, write=True), name=name[1:])


def _choose_syntax(exchange: Exchange) -> str:
    """Return the syntax of a requested Thing Description: JSON, unless RDF is preferred."""
    return choose_offer(exchange.accept, (MEDIA_TYPE, *RDF_BODIES)) or MEDIA_TYPE


class RobotThing(Resource):
    """`/.well-known/wot`: well-known URL of the Thing Description of a host (WoT Discovery 6.3)."""

    kind = "Thing Description"
    item = PathItem(
        "The Thing Description of the whole robot", (MEDIA_TYPE, *RDF_BODIES), OBJECT, PART_QUERY, streams=False
    )
    links = (RESOURCE,)

    def __init__(self, space: Space, things: ThingDescriptions) -> None:
        super().__init__(space, f"{space.base}.well-known/wot")
        self.things = things

    async def custom_get(self, exchange: Exchange) -> Response | None:
        tree = await self.things.affordances.tree()
        description = self.things.of_robot(tree, exchange.permissions)
        return self.things.response(exchange, self.url, self.url, description)
