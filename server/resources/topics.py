"""Topics: read as their latest messages, written by publishing (paper, Table 2)."""

from __future__ import annotations

import contextlib
import re
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import cast

from msgspec.structs import replace
from pyoxigraph import Triple
from starlette.responses import Response

from rosld.adapters.base import Watch
from rosld.adapters.catalogue import Selection
from rosld.adapters.model import Graph, Kind, MessageSchema, Operation, RosError, Sample, Topic
from rosld.ontology.body import parse_json
from rosld.ontology.describe_body import sources_of_topic
from rosld.ontology.describe_topics import topic_document
from rosld.ontology.document import Document
from rosld.ontology.geometry import is_on_earth
from rosld.ontology.lift import lifter
from rosld.ontology.literals import date_time
from rosld.ontology.observations import role_of
from rosld.server.history.history import History
from rosld.server.html.forms import DeleteForm, Form, message_form
from rosld.server.html.inputs import Json
from rosld.server.html.page import Csrf, Notice, Page
from rosld.server.html.site import Site
from rosld.server.http.conditional import digest, require_if_match
from rosld.server.http.problem import Problem
from rosld.server.hypermedia.json_schema import ANYTHING, OBJECT, MessageSchemas, message_schema, nullable, patch_schema
from rosld.server.pictures.picture_cache import can_draw
from rosld.server.resources.accepted_shape import message_shape, shape_query
from rosld.server.resources.holds import create_hold, hold_form, hold_parameters, hold_schema
from rosld.server.resources.limit_checks import STRICTNESS
from rosld.server.resources.memento import (
    SETTLED_NS,
    TIMEMAP,
    VARY,
    Memento,
    is_recorded,
    memento_datetime,
    negotiate_topic,
    present,
    read_history,
    read_time,
    time_map_of,
    timegate_links,
    wanted_datetime,
)
from rosld.server.resources.messages import (
    CLOUD_PARAMETERS,
    GEO_FORMAT,
    GEO_JSON,
    MOTION,
    PARTS,
    PICTURE_FORMAT,
    PICTURE_PARAMETERS,
    PICTURES,
    DecodedSample,
    cloud_is_preferred,
    cloud_response,
    decode,
    field_response,
    geojson_is_preferred,
    geojson_response,
    is_cloud,
    lift_sample,
    picture_motion,
    picture_response,
    picture_type,
    require_cloud,
    require_picture,
)
from rosld.server.resources.publisher import PublishingResource
from rosld.server.resources.series import PARAMETERS, require_history, series_of
from rosld.server.rest.exchange import Exchange
from rosld.server.rest.formats import FORMATS, JSON, MERGE_PATCH, OFFERS, RDF_BODIES, SPARQL_UPDATE
from rosld.server.rest.path_item import FIELD, FIELD_READS, FORMAT, PathItem, QueryParameter, WriteMethod
from rosld.server.rest.resource import READ, Answer, Motion, Plan, Resource, RobotWrite
from rosld.server.rest.state import MessageState, State
from rosld.server.robot.publication import publish
from rosld.server.robot.topic_view import TopicView
from rosld.server.robot.velocity import is_velocity_topic
from rosld.server.robot.write_policy import RESERVED, denied_reason
from rosld.server.runtime.tasks import combine_watches
from rosld.server.runtime.version_cache import IdentityKey

_LEGAL = re.compile(r"(/[A-Za-z][A-Za-z0-9_]*)+")
"""Pattern of topic names that are valid in both ROS 1 and ROS 2."""
_LATCH = QueryParameter("latch", "Whether later subscribers get the message.", {"type": "boolean"})


class TopicResource(PublishingResource):
    """One topic."""

    accepts: Mapping[str, Sequence[str]] = {
        "PUT": (*RDF_BODIES, JSON),
        "PATCH": (MERGE_PATCH, SPARQL_UPDATE),
        "POST": (*RDF_BODIES, JSON),
    }

    _allowed: tuple[Graph, frozenset[str], str | None] | None = None

    @property
    def history(self) -> History:
        """The continuous recording of topics."""
        return self.services.history

    async def prepare(self) -> None:
        """Add links to the TimeGate and the TimeMap if the topic is recorded."""
        gate = timegate_links(self.url) if is_recorded(self.history, self.name) else ()
        self.links = (*type(self).links, *gate)

    def path_item(self, schemas: MessageSchemas) -> PathItem:
        topic = self.found
        schema = None if topic is None else schemas.find(topic.type, MessageSchema)
        methods = self.methods()
        return PathItem(
            "A topic that can be created" if topic is None else f"The topic {self.name}",
            # FIELD_READS include the bytes of a cloud.
            (*FIELD_READS, *(PICTURES if self.is_picture else ()), *((GEO_JSON,) if self.is_on_earth else ())),
            ANYTHING if schema is None else nullable(schemas.read(schema)),
            (PICTURE_FORMAT, FIELD, *PARAMETERS, *TIMEMAP, *PICTURE_PARAMETERS)
            if self.is_picture
            else (*self._format_parameters, FIELD, *PARAMETERS, *TIMEMAP),
            self._writes(schema, schemas),
            has_shape=topic is not None and topic.type is not None,
            methods=methods | {"DELETE"} if "PUT" in methods else methods,  # available once rosld publishes
        )

    def _writes(self, schema: MessageSchema | None, schemas: MessageSchemas) -> Mapping[str, WriteMethod]:
        """Return the request and response of each writing method; `schema` is None for an unknown type."""
        sent, patch = schemas.write(schema), OBJECT
        if schema is not None:
            patch = patch_schema(message_schema(schema, schemas.lifting, read=False, sent=True))
        hold = hold_parameters(self.session.settings.hold_time, "" if self.commands_velocity else "rate")
        publishes, ends = "Publishes a message.", "At once: 204 if a node received it, 202 if none."
        if self.commands_velocity:
            ends += " A base stops soon after: POST holds."
        if self.found is None:
            publishes = "Creates a topic from RDF that states the type of the message."
        return {
            "PUT": WriteMethod(publishes, sent, ends, done=(200, 201, 202, 204), query=(*STRICTNESS, _LATCH)),
            "PATCH": WriteMethod(
                "Publishes the latest message with changes.",
                patch,
                done=(200, 202, 204),
                query=(_LATCH,),
            ),
            "POST": WriteMethod(
                "Holds the topic: publishes the message `rate` times per second.",
                sent,
                "After `for`, or `lease` after the last PATCH of its URL (Location), or by DELETE of that.",
                done=(201,),
                shows=hold_schema(schemas, schema),
                query=(*STRICTNESS, *hold),
            ),
            "DELETE": WriteMethod(
                "Stops advertising the topic; 405 if this server does not advertise it.", done=(204,)
            ),
        }

    def methods(self) -> frozenset[str]:
        return self._allowance()[1]

    @property
    def withheld(self) -> frozenset[str]:
        """The writing methods while the robot is stopped, except those that can send zero to a velocity topic."""
        return super().withheld - {"PUT", "POST"} if self._takes_zero else super().withheld

    @property
    def _takes_zero(self) -> bool:
        """Whether it is a velocity topic."""
        topic = self.found
        return topic is not None and is_velocity_topic(topic, self.session.graph, self.session.settings.stop_zero)

    @property
    def is_holdable(self) -> bool:
        """Whether the topic can be held now."""
        return "POST" in self.methods() and not self.session.is_stopped

    def unwritable_reason(self) -> str | None:
        """Return a sentence why publishing is not allowed, or None if it is."""
        return self._allowance()[2]

    def _allowance(self) -> tuple[Graph, frozenset[str], str | None]:
        """Return the current graph with its methods and refusal, computed once per graph."""
        graph = self.session.graph
        if self._allowed is None or self._allowed[0] is not graph:
            refusal = self._refusal(graph)
            methods = READ if refusal is not None else READ | _writing_methods(graph, self.name)
            is_missing = super().is_absent
            self._allowed = (graph, methods - {"GET", "HEAD"} if is_missing else methods, refusal)
        return self._allowed

    def _refusal(self, graph: Graph) -> str | None:
        """Return a sentence why publishing is not allowed, or None if publishing or creating the topic is."""
        name, permitted, found = self.name, self.session.settings.allow_publish, self.found_in(graph)
        if self.closed_reason is not None:
            return self.closed_reason
        if not self.allows(Operation.PUBLISH):
            return f"Nothing can be published on {name} of a {self.session.adapter.capabilities.system}."
        if found is not None:
            return denied_reason(found, graph, permitted)
        if name in RESERVED and name not in permitted:
            return f"{name} belongs to ROS itself."
        return None if _LEGAL.fullmatch(name) else f"{name!r} is not a valid name for a new topic."

    @property
    def is_absent(self) -> bool:
        return False  # PUT may create it

    def deny_reason(self, method: str) -> str:
        reason = self.unwritable_reason()
        if method == "DELETE" and reason is None:
            return f"rosld does not advertise {self.name}, so there is nothing to delete."
        return reason or super().deny_reason(method)

    @property
    def deny_about(self) -> Sequence[str]:
        return () if self.found is None else [self.space.node(each.node) for each in self.found.publishers]

    async def state(self) -> State:
        view = self.session.topics.find_view(self.name)
        if view is None:
            if self.name not in self.session.graph.topics:
                raise self.missing()
            view = await self.session.topics.read(self.name)
        return await self.state_of(view)  # reads the graph after the wait, so that publishers match the values

    async def state_of(self, view: TopicView) -> State:
        """Return the state with these values, without waiting if the types of the messages are cached."""
        graph = self.session.graph
        topic = graph.topics.get(self.name) or Topic(self.name)
        hold = self.services.holds.find_by_topic(self.name)
        version = (
            *(IdentityKey(topic), IdentityKey(view), graph.simulated_time, hold and hold.id, self.is_holdable),
            is_recorded(self.history, self.name),
            sources_of_topic(topic, graph),
            self.session.schemas.find_message(topic.type) is not None,
        )
        known = self.states.find(self.url, version)
        if known is None:
            decoded = [await decode(self.session.schemas, sample) for sample in view.samples]
            known = self.states.put(self.url, version, self._state(topic, view, decoded))
        return known

    def page(
        self, site: Site, state: State, forms: Sequence[Form], csrf: Csrf, notices: Sequence[Notice]
    ) -> Page | bytes:
        """Return its page; that of a collection says in how many recordings the topic is."""
        page, catalogue = super().page(site, state, forms, csrf, notices), self.session.adapter.catalogue
        if catalogue is None or not isinstance(page, Page):
            return page
        count = catalogue.number_of(Selection(topics=frozenset({self.name})))
        words = f"There are no live messages, but {count:,} recordings have them: /bags/?topic={self.name}."
        return replace(page, summary=words)

    async def watch(self, wake: Callable[[], None]) -> Watch:
        holds = self.services.holds.changes.watch(wake, lambda about: about == self.name)
        return combine_watches(
            await self.session.topics.watch(self.name, wake), self.session.changes.watch(wake), holds
        )

    def _state(self, topic: Topic, view: TopicView, decoded: Sequence[DecodedSample]) -> State:
        newest = decoded[-1] if decoded else None

        def plain() -> bytes:
            if newest is None:
                return b"null"
            if newest.schema is None or newest.message is None:
                raise Problem(406, f"The messages of {self.name} cannot be read: {newest.reason}.")
            return lifter(newest.schema, self.session.lifting).json(newest.message, self.url)

        hold, can = self.services.holds.find_by_topic(self.name), self.is_holdable
        of_body = sources_of_topic(topic, self.session.graph)
        key = f"{topic!r}{view.version_key()}{hold and hold.id}{can}{[one.reason for one in decoded]}{of_body or ''}"
        token = digest(key.encode("utf-8", "replace"))
        recorded = bool(self.session.adapter.recordings)  # recorded times would give a wrong Age (RFC 9111 5.1)
        received = view.newest.received_ns if view.newest and not recorded else None
        return MessageState(
            lambda: self._document(topic, view, decoded, None if hold is None else hold.id, holdable=can),
            plain,
            token,
            received,
            headers={"vary": VARY} if is_recorded(self.history, self.name) else {},
            shapes=self._shapes(topic, decoded),
            messages=() if view.times else tuple((one.publisher, one.epoch, one.sequence) for one in view.samples),
        )

    def _shapes(self, topic: Topic, decoded: Sequence[DecodedSample]) -> tuple[str, ...]:
        """Return the shapes of the messages; none for conflicting types, as `/shapes/` has one shape per name."""
        if len(topic.types) > 1:
            return ()
        schemas = (one.schema for one in decoded)
        return tuple(dict.fromkeys(self.space.shape(one.ref.name) for one in schemas if one is not None))

    def _document(
        self, topic: Topic, view: TopicView, decoded: Sequence[DecodedSample], hold: str | None, *, holdable: bool
    ) -> Document:
        """Return the RDF of the topic. Reads the graph late, so that cached states retain none."""
        graph, schema = self.session.graph, self.session.schemas.find_message(topic.type)
        role, lifting = role_of(topic, graph, schema), self.session.lifting
        found = [lift_sample(self.space, lifting, one, topic.name, role) for one in decoded if one.message is not None]
        reason = next((one.reason for one in decoded if one.reason), topic.unreadable)
        return topic_document(
            topic, self.space, graph, view.rate, found, unreadable=reason,
            holdable=holdable, hold=hold, schema=schema,
        )  # fmt: skip

    @property
    def constrained_by(self) -> str | None:
        topic = self.found
        return None if topic is None or topic.type is None else shape_query(self.url)

    async def accepted(self, url: str) -> Document | None:
        topic = self.found
        if topic is None or topic.type is None:
            return None
        schema = await self.session.schemas.message(topic.type)
        return await message_shape(self.limit_checks, Kind.TOPIC, self.name, schema, url)

    async def forms(self) -> Sequence[Form]:
        methods, topic = self.methods(), self.found
        forms: list[Form] = []
        if "PUT" in methods and topic is not None and topic.type is not None:
            with contextlib.suppress(RosError):
                forms += await self._message_forms(await self.session.schemas.message(topic.type))
        if "DELETE" in methods:
            forms.append(DeleteForm("Stop advertising", "Stop advertising", f"rosld no longer publishes {self.name}."))
        return forms

    async def _message_forms(self, schema: MessageSchema) -> Sequence[Form]:
        """Return the forms to publish and hold, one with a pad first; while the robot is stopped, one for zero only."""
        if self.session.is_stopped:
            return (
                message_form(schema, title="Publish zero", about="The robot is stopped: everything else is refused."),
            )
        latest = await self._latest_json()
        bounds = await self.limit_checks.message_bounds(Kind.TOPIC, self.name, schema)
        hold = hold_form(self.session, self.name, schema, latest, bounds)
        publish = message_form(schema, value=latest, bounds=bounds)
        return (publish, hold) if hold.pad is None else (hold, publish)

    async def _latest_json(self) -> Json:
        """Return the latest message as plain JSON, or None if there is no readable one."""
        view = self.session.topics.find_view(self.name)
        if view is None or view.newest is None:
            return None
        decoded = await decode(self.session.schemas, view.newest)
        if decoded.schema is None or decoded.message is None:
            return None
        return cast(Json, parse_json(lifter(decoded.schema, self.session.lifting).json(decoded.message, self.url)))

    async def select_variant(self, exchange: Exchange) -> Resource:
        """Return the part of the history that `?series=FIELD`, `?at=TIME` or `?timemap` selects.

        Raises a redirection to a memento for a request with `Accept-Datetime` (RFC 7089 4.1).
        """
        if exchange.method in ("GET", "HEAD"):
            query = exchange.query if exchange.request.scope["query_string"] else {}
            asks_the_past = not query.keys().isdisjoint(("series", "timemap", "timegate", "at"))
            if asks_the_past and self.found is None and not is_recorded(self.history, self.name):
                raise self.missing()
            if "series" in query:
                return series_of(self.space, self.history, self.name, exchange)
            if "timemap" in query:
                require_history(self.history, self.name)
                topics = frozenset({self.name})
                return time_map_of(self.space, self.history, self.url, self.name, topics, exchange)
            if "at" in query:
                return await self._past(query["at"])
            if "timegate" in query:
                require_history(self.history, self.name)
            if is_recorded(self.history, self.name):
                wanted = wanted_datetime(exchange)
                if wanted is not None:
                    raise await negotiate_topic(self.space, self.history, self.name, wanted)
                return await present(await super().select_variant(exchange), exchange)
        return await super().select_variant(exchange)

    async def _past(self, text: str) -> Resource:
        """Return a memento of the topic. Raises Problems."""
        require_history(self.history, self.name)
        at, now = read_time(text, time.time_ns()), time.time_ns()
        sample = await read_history(lambda: self.history.writer.latest_at(self.name, at))
        if sample is None:
            since = date_time(0, self.history.recording.start_ns)
            raise Problem(404, f"{self.name} was not recorded until {text[:60]}: the history begins at {since}.")
        state = partial(self._past_state, sample, is_settled=at < now - SETTLED_NS)
        return Memento(self, "Topic as it was", text, state, partial(self._get_part, sample))

    async def _past_state(self, sample: Sample, *, is_settled: bool) -> State:
        """Return the state of a memento with this message."""
        decoded = await decode(self.session.schemas, sample)
        state = self._state(self.found or Topic(self.name), TopicView((sample,)), [decoded])
        headers = {"memento-datetime": memento_datetime(sample.received_ns)} if is_settled else {}
        return replace(state, headers={**headers, "vary": VARY}, received_ns=None)

    @property
    def is_picture(self) -> bool:
        """Whether its messages can be rendered as pictures."""
        topic = self.found
        return topic is not None and any(can_draw(ref.name) for ref in topic.types)

    @property
    def is_cloud(self) -> bool:
        """Whether its messages are point clouds."""
        topic = self.found
        return topic is not None and any(is_cloud(ref.name) for ref in topic.types)

    @property
    def is_on_earth(self) -> bool:
        """Whether its messages state positions in WGS84."""
        topic = self.found
        return topic is not None and any(is_on_earth(ref.name) for ref in topic.types)

    @property
    def _format_parameters(self) -> Sequence[QueryParameter]:
        return CLOUD_PARAMETERS if self.is_cloud else (GEO_FORMAT if self.is_on_earth else FORMAT,)

    async def custom_get(self, exchange: Exchange) -> Response | Motion | None:
        """Return a field of the latest message (`?field=PATH`), or its picture, points or GeoJSON if preferred.

        Raises a 404 Problem if there is no message or no such field.
        """
        return await self._get_part(None, self, exchange)

    async def _get_part(
        self, recorded: Sample | None, resource: Resource, exchange: Exchange
    ) -> Response | Motion | None:
        """Return the requested part of the newest message, or of a recorded one."""
        has_field = "field" in exchange.query
        if not has_field and exchange.preferred(FORMATS, PARTS) in OFFERS:
            return None  # whatever the types of its messages are
        is_cloud = cloud_is_preferred(exchange, is_cloud=self.is_cloud)
        wanted = None if is_cloud else picture_type(exchange, is_picture=self.is_picture)
        is_geojson = not has_field and geojson_is_preferred(exchange) and self.is_on_earth
        if not is_cloud and wanted is None and not has_field and not is_geojson:
            return None
        types = self.require().types if recorded is None else (recorded.schema,)
        if is_cloud:
            require_cloud(self.name, types)
        elif wanted is not None:
            require_picture(self.name, types)
        schemas, pictures, name = self.session.schemas, self.services.pictures, self.name
        newest = recorded or (await self.session.topics.read(name, wait_for_publisher=True)).newest
        if is_geojson and newest is not None:
            return await geojson_response(resource, schemas, newest, exchange, pictures.instance_id)
        if wanted == MOTION and recorded is None:
            return await picture_motion(self.session, pictures, name, newest, exchange)
        if newest is None:
            part = "position" if is_geojson else "points" if is_cloud else "picture" if wanted else None
            part = part or f"field {exchange.query['field']!r}"
            raise Problem(404, f"{name} has no message yet, so no {part}.")
        if is_cloud:
            return await cloud_response(resource, schemas, pictures, name, newest, exchange)
        if wanted is not None:
            return await picture_response(resource, schemas, pictures, name, newest, exchange, wanted)
        return await field_response(schemas, newest, exchange.query["field"])

    async def plan_graph_write(self, triples: Sequence[Triple] | None) -> Plan:
        if self.unwritable_reason() is not None:
            raise self.not_allowed("PUT", 403)
        if triples is None:
            raise Problem(403, f"{self.name} exists as long as a node has it: it cannot be deleted.")
        publication = await self.plan_graph(triples)

        async def carried_out() -> bool:
            return (await publish(self.session, publication)).matched > 0

        return RobotWrite(f"publish a {publication.type.name} on {self.name}", carried_out)

    async def put(self, exchange: Exchange) -> Answer:
        """Publish the message in the body: 204, or 202 without a subscriber, or 201 if that created the topic."""
        return await self.carry_out(await self.plan(exchange), exchange)

    async def post(self, exchange: Exchange) -> Answer:
        """Hold the topic: publish the message in the body repeatedly while the lease is renewed.

        Answers 201 with the hold.
        """
        return await create_hold(exchange, self)

    async def patch(self, exchange: Exchange) -> Answer:
        """Publish the latest message with the changes of a patch. Raises a 428 Problem without If-Match."""
        require_if_match(exchange.header("if-match"), "PATCH changes the latest message, which changes often.")
        description = (await self.state()).document.triples
        publication = await self.plan_patch(exchange, description)
        return await self.carry_out(publication, exchange)

    async def delete(self, exchange: Exchange) -> Answer:
        """Stop advertising the topic."""
        await self.session.adapter.unadvertise(self.name)
        return Response(status_code=204)


def _writing_methods(graph: Graph, name: str) -> frozenset[str]:
    topic = graph.topics.get(name)
    if topic is None:
        return frozenset({"PUT"})
    is_advertised = any(endpoint.node == graph.own_node for endpoint in topic.publishers)
    methods = frozenset({"PUT", "PATCH"} if topic.type is None else {"PUT", "PATCH", "POST"})
    return methods | {"DELETE"} if is_advertised else methods
