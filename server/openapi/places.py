"""The places of a robot: every URL that it has now, and templates of those that come and go."""

from __future__ import annotations

import asyncio
import re
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from itertools import islice
from typing import TypeAlias

from rosld.adapters.model import (
    ActionSchema,
    GoalStatus,
    Graph,
    MessageSchema,
    RosError,
    Schema,
    ServiceSchema,
    TypeRef,
    names,
)
from rosld.ontology.describe_holds import LEAST_OF_HOLDS, MOST_LEASE, MOST_RATE
from rosld.ontology.namespaces import Members
from rosld.ontology.notifications import CHANNEL_TYPES
from rosld.server.events.source import LINES
from rosld.server.http.problem import Problem
from rosld.server.hypermedia import json_schema
from rosld.server.hypermedia.conditions import url_of
from rosld.server.hypermedia.json_schema import ANYTHING, OBJECT, TEXT, or_null
from rosld.server.hypermedia.resource_tree import ActionPlan, ResourceTree
from rosld.server.hypermedia.schema import DataSchema, Json, message_schema, value_schema
from rosld.server.hypermedia.thing_description import MEDIA_TYPE as THING
from rosld.server.openapi.components import reference
from rosld.server.openapi.place import Place, Query
from rosld.server.resources.context import Robot
from rosld.server.resources.kept.sources import N3_PATCH
from rosld.server.resources.namespaces import listed, namespaces
from rosld.server.resources.nodes import TRANSITION
from rosld.server.resources.sparql import FORMATS as RESULT_FORMATS
from rosld.server.resources.sparql import formats_of
from rosld.server.rest.formats import FORMATS, HTML, MERGE_PATCH, OFFERS, RDF_BODIES, SPARQL_UPDATE
from rosld.server.rest.resource import READ, Resource
from rosld.server.robot.session import used_types
from rosld.server.sparql.protocol import DIRECT, UPDATE
from rosld.server.sparql.results import GRAPHS, SOLUTIONS
from rosld.server.sparql.stored import Type

Resolve: TypeAlias = Callable[[str], Resource]
"""The resource at a path below the base."""

OPENAPI = ("application/json", "application/openapi+json", "application/vnd.oai.openapi+json")
"""What the description itself is called: its registered names come after the one that every tool knows."""
_PATIENCE = 3.0
"""How long to wait for types that must be asked for; those that come later are in the next description."""

_FORMAT = Query("format", "The representation wanted, before Accept.", {"type": "string", "enum": [*FORMATS]})
_THING_FORMAT = replace(_FORMAT, schema={"type": "string", "enum": [*FORMATS, "td"]})
_FIELD = Query("field", "The path of one field, such as `pose.position.x`: its bytes are the answer.")
_HASH = Query("hash", "Which of several definitions of one name.")
_PAGE = Query("page", "A page of messages, from 0.", {"type": "integer", "minimum": 0})
_DEFAULTS = Query(
    "defaults", "Whether fields that JSON leaves out are ROS's defaults.", {"type": "boolean"}, of=frozenset({"PUT"})
)
_LATCH = Query(
    "latch", "Whether subscribers that come later get the message.", {"type": "boolean"}, of=frozenset({"PUT", "PATCH"})
)
_POSITIVE: Mapping[str, Json] = {"type": "number", "minimum": LEAST_OF_HOLDS}
_HOLDING = (
    Query("rate", "How many times a second the message is published.", {**_POSITIVE, "maximum": MOST_RATE}),
    Query("lease", "The seconds that the hold goes on unrenewed.", {**_POSITIVE, "maximum": MOST_LEASE}),
    Query("then", "What is published when the hold ends: zero, none, or the URL of a message."),
)
_KEEP = Query("keep", "Whether the event stream that is asked for keeps the hold.", {"type": "boolean"})
_KEPT_ALSO = (303, 410, 507)
_MOST_QUERIES = 1000
MOST_SINGLE = 1000
"""Parameters, and resources with their properties and actions, that are described one by one; a template has more."""
_OR_ANOTHER = f", or one beyond the {MOST_SINGLE} that are described one by one"
_LONGEST = 300
_ANY_TYPE = "*/*"
_BYTES = "application/octet-stream"
_FIELD_READS = (*OFFERS, _BYTES, "text/plain")
_RESULTS = tuple(dict.fromkeys((*SOLUTIONS, *GRAPHS, HTML)))
_PARAMETER: Mapping[str, Json] = {"type": ["string", "number", "boolean", "array"]}
_NEW_PARAMETER: DataSchema = {"type": ["string", "number", "boolean", "array", "object"]}
_IRI: DataSchema = {
    "type": "string",
    "pattern": r"""^(/|[A-Za-z][A-Za-z0-9+.-]*:)([^\x00-\x20\x7f<>"{}|\\^`%\[\]]|%[0-9A-Fa-f]{2})*$""",
}
"""An absolute IRI, or a path below the base."""
_GRAPHS: DataSchema = {"type": "array", "items": {"type": "string", "format": "uri"}}
_OF_UPDATES = (
    Query("using-graph-uri", "The graphs that are the default graph of an update together.", _GRAPHS),
    Query("using-named-graph-uri", "The named graphs of an update.", _GRAPHS),
    Query("dry-run", "Whether an update is only to be planned, and the plan told.", {"type": "boolean"}),
)
_HIDDEN = Query("hidden", "Whether names with a segment that begins with `_` are told, too.", {"type": "boolean"})
_GRAPH = Query(
    "graph",
    "The graph: the URL of what it is about, answered as that URL answers (SPARQL 1.1 Graph Store HTTP Protocol).",
    {"type": "string", "format": "uri-reference"},
)
_DEFAULT = Query("default", "Instead of a graph: all of them together.")
_ALL = Query("all", "Instead of a graph: all of them with their names, as N-Quads, TriG or JSON-LD.")
_GRAPH_FORMAT = replace(_FORMAT, schema={"type": "string", "enum": [*{**FORMATS, **formats_of("CONSTRUCT")}]})
_RESULT_FORMAT = replace(_FORMAT, schema={"type": "string", "enum": [*RESULT_FORMATS]})
_TIMEOUT = Query("timeout", "The seconds that the query may take.", {"type": "number", "exclusiveMinimum": 0})
_TYPES: Mapping[Type, DataSchema] = {
    Type.IRI: _IRI,
    Type.STRING: TEXT,
    Type.INTEGER: {"type": "integer"},
    Type.DOUBLE: {"type": "number"},
}
_SUBSCRIPTION: DataSchema = {
    "type": "object",
    "properties": {
        "@context": {},
        "type": TEXT,
        "topic": {"type": "string", "format": "uri"},
        **dict.fromkeys(("rate", "state", "startAt", "endAt", "accept"), TEXT),
    },
    "required": ["@context", "type", "topic"],
}
_INVOKES = "Invokes the action; what is shown then is the resource that it belongs to."
_SENDS_A_GOAL = "Sends a goal, which is what is made; 409 where it is rejected."
_NOT_IN_A_KEY = re.compile(r"[^A-Za-z0-9._-]")


async def learn(robot: Robot) -> None:
    """See to it that the types in use are at hand, as far as the robot tells them in time."""
    unknown = [ref for ref in used_types(robot.graph) if _at_hand(robot, ref) is None]
    if not unknown:
        return

    async def find(ref: TypeRef) -> None:
        try:
            await robot.schemas.find(ref)
        except (RosError, asyncio.TimeoutError):
            pass

    tasks = [asyncio.ensure_future(find(ref)) for ref in unknown]
    _, late = await asyncio.wait(tasks, timeout=_PATIENCE)
    for task in late:
        task.cancel()


def _at_hand(robot: Robot, ref: TypeRef) -> Schema | None:
    return robot.schemas.at_hand(ref) or robot.schemas.named(ref.name)


def _holding(method: str, required: str = "") -> Iterator[Query]:
    """The parameters of what begins a hold, or changes it."""
    for each in _HOLDING:
        yield replace(each, of=frozenset({method}), of_reads=False, required=each.name == required)


@dataclass
class Places:
    """Finds the places. `resolve` gives the resources, which say what they answer; nothing is waited for."""

    robot: Robot
    layout: ResourceTree
    resolve: Resolve
    schemas: dict[str, DataSchema] = field(default_factory=dict)
    """The schemas that places refer to by name."""
    hidden: bool = False
    """Whether hidden names have places too."""
    _named: dict[TypeRef, str] = field(default_factory=dict)

    @property
    def graph(self) -> Graph:
        """What is listed of the graph."""
        return self.robot.graph if self.hidden else listed(self.robot)

    def all(self) -> Iterator[Place]:
        """Every place."""
        yield self._place("/", "entry", "The robot, with links to everything")
        for room in ("nodes", "topics", "services", "actions"):
            yield from self._namespaces(room)
        yield from self._nodes()
        yield from self._topics()
        yield from self._services()
        yield from self._calls()
        yield from self._actions()
        yield from self._goals()
        yield from self._activity()
        yield from self._holds()
        yield self._stop()
        yield self._status()
        yield from self._parameters()
        yield from self._resources()
        yield from self._types()
        yield from self._bags()
        yield from self._mappings()
        yield from self._data()
        yield from self._stored_queries()
        yield self._sparql()
        yield self._graphs()
        yield from self._channels()
        with suppress(Problem):  # there is one only if it was asked for
            yield self._place("/mirror", "queries", "The mirror of the dataset in another store")
        yield from self._rest()

    # What all have in common

    def _place(self, path: str, tag: str, summary: str, *, at: str | None = None) -> Place:
        """A place as its resource has it; `at` is a path that a template stands for."""
        resource = self.resolve(at or path)
        methods = resource.methods()
        accepts = {method: tuple(kinds) for method, kinds in resource.accepts.items() if method in methods}
        return Place(path, tag, summary, methods, OFFERS, accepts, query=(_FORMAT,))

    def _leaves_out(self, path: str) -> bool:
        return not self.hidden and self.robot.adapter.capabilities.hidden_names and names.is_hidden(path)

    @property
    def _of_listings(self) -> tuple[Query, ...]:
        """The queries of a listing of names."""
        return (_FORMAT, _HIDDEN) if self.robot.adapter.capabilities.hidden_names else (_FORMAT,)

    def _path(self, url: str) -> str:
        return url[len(self.robot.space.base) - 1 :]

    def _namespaces(self, room: str) -> Iterator[Place]:
        for namespace in namespaces(self.graph, room):
            path = self._path(self.robot.space.container(room, namespace))
            place = self._place(path, room, room.capitalize())
            yield replace(place, alike=f"namespace-of-{room}", pages=True, query=self._of_listings)

    def _message(self, ref: TypeRef | None) -> MessageSchema | None:
        found = None if ref is None else _at_hand(self.robot, ref)
        return found if isinstance(found, MessageSchema) else None

    def _service(self, ref: TypeRef | None) -> ServiceSchema | None:
        found = None if ref is None else _at_hand(self.robot, ref)
        return found if isinstance(found, ServiceSchema) else None

    def _read(self, schema: MessageSchema | None) -> DataSchema:
        """What a message is when it is read: a reference to its schema."""
        return OBJECT if schema is None else self._shared(schema, "", json_schema.as_read)

    def _sent(self, schema: MessageSchema | None) -> DataSchema:
        """What a message must be when it is sent: a schema of its own only where that is another."""
        return OBJECT if schema is None else self._shared(schema, ".sent", json_schema.as_sent)

    def _shared(self, schema: MessageSchema, suffix: str, adapted: Callable[[DataSchema], DataSchema]) -> DataSchema:
        made = adapted(message_schema(schema, self.robot.lifting))
        key = self._key(schema.ref)
        if suffix and self.schemas.get(key, made) != made:
            key += suffix
        self.schemas.setdefault(key, made)
        return reference("schemas", key)

    def _key(self, ref: TypeRef) -> str:
        """The name of the schema of a type; variants of one type have their hash in it."""
        key = self._named.get(ref)
        if key is None:
            key = _NOT_IN_A_KEY.sub(".", ref.name)
            if key in self._named.values():
                key = f"{key}.{_NOT_IN_A_KEY.sub('.', ref.hash or '')}.{len(self._named)}"
            self._named[ref] = key
        return key

    # The computation graph

    def _nodes(self) -> Iterator[Place]:
        sent: DataSchema = {"type": "object", "properties": {TRANSITION: TEXT}, "required": [TRANSITION]}
        note = "Has a managed node make a transition of its lifecycle; 409 tells its state and what is legal in it."
        for name in self.graph.nodes:
            place = self._place(self._path(self.robot.space.node(name)), "nodes", "A node")
            managed = replace(place, sends={"POST": sent}, done={"POST": (200, 204)}, notes={"POST": note})
            yield replace(managed, alike="managed-node") if "POST" in place.methods else replace(place, alike="node")

    def _topics(self) -> Iterator[Place]:
        for name, topic in self.graph.topics.items():
            path = self._path(self.robot.space.topic(name))
            yield self._topic(self._place(path, "topics", f"The topic {name}"), self._message(topic.type))
        new = self._place("/topics/{name}", "topics", "A topic that may be made", at="/topics/new")
        about = "A name; those of several parts have slashes, as in the URL."
        note = "Makes a topic that is not there yet: RDF that states the type of the message."
        yield replace(self._topic(new, None), segments={"name": about}, notes={"PUT": note})

    def _topic(self, place: Place, schema: MessageSchema | None) -> Place:
        sent = self._sent(schema)
        patch: DataSchema = json_schema.as_patch(message_schema(schema)) if schema is not None else OBJECT
        return replace(
            place,
            methods=place.methods | {"DELETE"} if "PUT" in place.methods else place.methods,  # once rosld publishes
            reads=_FIELD_READS,
            plain=or_null(self._read(schema)) if schema is not None else ANYTHING,
            sends={"PUT": sent, "PATCH": patch, "POST": sent},
            done={"PUT": (200, 201, 202, 204), "PATCH": (200, 202, 204), "DELETE": (204,), "POST": (201,)},
            shows={"POST": self._hold(schema)},
            query=(
                _FORMAT,
                _FIELD,
                replace(_DEFAULTS, of=frozenset({"PUT", "POST"})),
                _LATCH,
                *_holding("POST", required="rate"),
            ),
            notes={
                "PUT": "Publishes a message.",
                "PATCH": "Publishes the latest message with changes.",
                "POST": "Holds the topic: publishes the message `rate` times a second while the lease is renewed.",
                "DELETE": "Stops to advertise the topic; 405 while this server does not advertise it.",
            },
        )

    def _hold(self, schema: MessageSchema | None) -> DataSchema:
        """How a hold stands, as plain JSON."""
        number: DataSchema = {"type": "number"}
        words: DataSchema = {"id": TEXT, "topic": TEXT, "holder": TEXT, "rate": number, "lease": number, "then": TEXT}
        message = ANYTHING if schema is None else self._read(schema)
        rest: DataSchema = {"kept": {"type": "boolean"}, "trouble": or_null(TEXT), "message": message}
        return {"type": "object", "properties": {**words, **rest}}

    def _holds(self) -> Iterator[Place]:
        yield self._place("/holds/", "holds", "The holds of topics")
        hold = self._place("/holds/{id}", "holds", "A hold of a topic", at="/holds/any")
        patch = frozenset({"PATCH"})
        yield replace(
            hold,
            plain=self._hold(None),
            sends={"PATCH": ANYTHING},
            optional=patch,
            done={"PATCH": (200, 204), "DELETE": (204,)},
            query=(_FORMAT, _KEEP, replace(_DEFAULTS, of=patch), *_holding("PATCH")),
            segments={"id": "As in the URL of the hold."},
            also=(410,),
            notes={
                "PATCH": "Renews the lease, with a body also the message, which goes on without a gap.",
                "DELETE": "Ends the hold; what it was told to say last is published.",
            },
        )

    def _status(self) -> Place:
        seconds: DataSchema = {"type": "number", "minimum": 0}
        told: DataSchema = dict.fromkeys(("longestPause", "longestWork", "recentPause"), seconds)
        told = {**told, **dict.fromkeys(("longestPauseEnd", "longestPauseCode", "longestWorkCode"), or_null(TEXT))}
        place = self._place(
            "/status", "status", "How promptly the server itself answers, what is wrong with its storage"
        )
        return replace(place, plain={"type": "object", "properties": told})

    def _stop(self) -> Place:
        stop = self._place("/stop", "stop", "The stop of the whole robot")
        step: DataSchema = {"type": "object", "properties": {"does": TEXT, "state": TEXT, "words": or_null(TEXT)}}
        who: DataSchema = dict.fromkeys(("by", "since", "reason"), or_null(TEXT))
        told: DataSchema = {"stopped": {"type": "boolean"}, **who, "steps": {"type": "array", "items": step}}
        plain: DataSchema = {"type": "object", "properties": told}
        reason: DataSchema = {"type": "string", "maxLength": 500}
        return replace(
            stop,
            plain=plain,
            sends={"POST": {"type": "object", "properties": {"reason": reason}, "additionalProperties": False}},
            optional=frozenset({"POST"}),
            done={"POST": (200, 204), "DELETE": (204,)},
            shows={"POST": plain},
            notes={
                "POST": "Ends every hold, cancels goals, runs the stop actions of mappings, and refuses writes (423).",
                "DELETE": "Lets writes reach the robot again.",
            },
        )

    def _services(self) -> Iterator[Place]:
        for name, service in self.graph.services.items():
            place = self._place(self._path(self.robot.space.service(name)), "services", f"The service {name}")
            schema = self._service(service.type)
            yield replace(
                place,
                sends={"POST": self._sent(schema.request if schema else None)},
                optional=frozenset({"POST"}),
                done={"POST": (201,)},
                shows={"POST": ANYTHING if schema is None else or_null(self._read(schema.response))},
                query=(_FORMAT, replace(_DEFAULTS, of=frozenset({"POST"}))),
                notes={"POST": "Calls the service; the call is a resource, and `Idempotency-Key` makes it once only."},
            )

    def _calls(self) -> Iterator[Place]:
        yield self._place("/calls/", "calls", "The calls that are kept")
        call = self._place("/calls/{id}", "calls", "A call of a service", at="/calls/any")
        segments = {"id": "As in the URL of the call."}
        yield replace(call, plain=ANYTHING, done={"DELETE": (204,)}, segments=segments, also=(410,))

    def _action(self, ref: TypeRef | None) -> ActionSchema | None:
        found = None if ref is None else _at_hand(self.robot, ref)
        return found if isinstance(found, ActionSchema) else None

    def _actions(self) -> Iterator[Place]:
        for name, action in self.graph.actions.items():
            place = self._place(self._path(self.robot.space.action(name)), "actions", f"The action {name}")
            schema = self._action(action.type)
            yield replace(
                place,
                sends={"POST": self._sent(schema.goal if schema else None)},
                optional=frozenset({"POST"}),
                done={"POST": (201,)},
                shows={"POST": self._goal(schema)},
                query=(_FORMAT, replace(_DEFAULTS, of=frozenset({"POST"}))),
                notes={"POST": "Sends a goal; the goal is a resource, and `Idempotency-Key` makes it once only."},
            )

    def _goal(self, schema: ActionSchema | None) -> DataSchema:
        """How a goal stands, as plain JSON."""
        parts = {} if schema is None else {"goal": schema.goal, "feedback": schema.feedback, "result": schema.result}
        told = {name: or_null(self._read(part)) for name, part in parts.items()}
        status: DataSchema = {"type": "string", "enum": [status.value for status in GoalStatus]}
        words: DataSchema = {"id": TEXT, "action": TEXT, "status": status, "words": or_null(TEXT)}
        return {"type": "object", "properties": {**words, **told}}

    def _goals(self) -> Iterator[Place]:
        yield self._place("/goals/", "goals", "The goals that are kept")
        goal = self._place("/goals/{id}", "goals", "A goal of an action", at="/goals/any")
        methods = READ if self.robot.settings.read_only else READ | {"DELETE"}
        yield replace(
            goal,
            methods=methods,
            plain=self._goal(None),
            done={"DELETE": (202, 204)},
            segments={"id": "As in the URL of the goal."},
            also=(409, 410),
            notes={"DELETE": "Cancels a goal that is pursued (202), forgets one that has ended (204)."},
        )

    def _activity(self) -> Iterator[Place]:
        container = self._place("/activity/", "activity", "The receipts of writes, the newest first")
        yield replace(container, pages=True, plain=ANYTHING)
        receipt = self._place("/activity/{id}", "activity", "The receipt of a write", at="/activity/any")
        yield replace(receipt, plain=ANYTHING, segments={"id": "As in the URL of the receipt."})

    def _parameters(self) -> Iterator[Place]:
        graph, space = self.graph, self.robot.space
        trees: dict[tuple[str, ...], Members | None] = {(): None, **namespaces(graph, "parameters")}
        for namespace in islice((each for each in trees if "" not in each), MOST_SINGLE):
            path = self._path(space.container("parameters", namespace))
            tree = self._place(path, "parameters", "A tree of parameters")
            yield replace(
                tree,
                plain=OBJECT,
                sends={"POST": ANYTHING, "PATCH": OBJECT},
                done={"POST": (200, 201, 204), "PATCH": (200, 204), "DELETE": (204,)},
                notes={"POST": "Makes a parameter, named by `Slug` where that is free."},
                alike="tree-of-parameters",
                pages=True,
                query=self._of_listings,
            )
        for name in islice((each for each in graph.parameters if "" not in names.segments(each)), MOST_SINGLE):
            place = self._place(self._path(space.parameter(name)), "parameters", "A parameter")
            yield replace(self._parameter(place), alike="parameter")
        summary = "A parameter that may be made" + ("" if len(graph.parameters) <= MOST_SINGLE else _OR_ANOTHER)
        new = self._place("/parameters/{name}", "parameters", summary, at="/parameters/new")
        about = "A name; those of several parts have slashes, as in the URL."
        yield replace(self._parameter(new), segments={"name": about})

    def _parameter(self, place: Place) -> Place:
        return replace(
            place,
            plain=dict(_PARAMETER),
            sends={"PUT": _NEW_PARAMETER, "PATCH": _NEW_PARAMETER},
            done={"PUT": (200, 201, 204), "PATCH": (200, 204), "DELETE": (204,)},
        )

    # Levels two and three

    def _resources(self) -> Iterator[Place]:
        number = 0
        for path in self.layout.paths:
            for place in self._complex(path):
                if self._leaves_out(place.path):
                    continue
                number += 1
                if number > MOST_SINGLE:
                    yield self._other_resources(place)
                    return
                yield place

    def _other_resources(self, one: Place) -> Place:
        """What stands for all resources and properties that are not described one by one, as `one` of them is."""
        summary = "One of the resources, properties and actions that are too many to be described one by one"
        return Place(
            "/resources/{name}",
            "resources",
            summary,
            one.methods,
            _FIELD_READS,
            dict.fromkeys(one.accepts, (_ANY_TYPE,)),
            query=(_FORMAT,),
            segments={"name": "A path, as in the URL: links lead to it."},
        )

    def _complex(self, path: str) -> Iterator[Place]:
        """A complex resource and what lies in it: properties, actions, names that are both."""
        plan = self.layout.complex(path)
        if plan is None:
            return
        offers, lifting = self.robot.offers, self.robot.lifting
        shown = {one: offers.member_affordance(one, write=True) for one in plan.members}
        values = {one: value_schema(each.shape, lifting) for one, each in shown.items()}
        place = self._place(self._path(url_of(path, self.robot.space)), "resources", f"The resource {path}")
        read = {one.name: or_null(json_schema.as_read(value)) for one, value in values.items()}
        sent = {one.name: json_schema.as_patch(each) for one, each in values.items() if offers.is_writable(one.of)}
        yield replace(
            place,
            reads=(*OFFERS, THING),
            plain={"type": "object", "properties": dict[str, Json](read)},
            sends={
                "PATCH": {"type": "object", "properties": dict[str, Json](sent), "additionalProperties": False},
            },
            done={"PATCH": (200, 204)},
            query=(_THING_FORMAT,),
            members={one.name: each.url for one, each in shown.items()},
        )
        properties = {one.at: value for one, value in values.items() if one.at is not None}
        actions = {one.name: one for one in plan.actions}
        for name in dict.fromkeys((*properties, *actions)):
            yield self._member(name, properties.get(name), actions.get(name))

    def _member(self, name: str, value: DataSchema | None, action: ActionPlan | None) -> Place:
        path = self._path(url_of(name, self.robot.space))
        place = self._place(path, "resources", f"The {'action' if value is None else 'property'} {name}")
        sent = ANYTHING if value is None else json_schema.as_sent(value)
        sends_goals = action is not None and action.sends_goals
        return replace(
            place,
            reads=_FIELD_READS,
            plain=None if value is None else or_null(json_schema.as_read(value)),
            sends={
                "PUT": sent,
                "PATCH": ANYTHING if value is None else json_schema.as_patch(value),
                "POST": self._sent(action.request if action else None),
            },
            optional=frozenset({"POST"}),
            done={"PUT": (200, 202, 204), "PATCH": (200, 202, 204), "POST": (201,) if sends_goals else (200, 204)},
            shows={"POST": OBJECT},
            query=(_FORMAT, _FIELD, replace(_DEFAULTS, of=frozenset({"POST"}))),
            notes={"POST": _SENDS_A_GOAL if sends_goals else _INVOKES},
        )

    # Everything else

    def _types(self) -> Iterator[Place]:
        names = {"package": "A package.", "kind": "`msg`, `srv` or `action`.", "name": "The name of a type."}
        for room in ("types", "shapes"):
            said, query = room.capitalize(), (_FORMAT, _HASH) if room == "types" else (_FORMAT,)
            root = self._place(f"/{room}/", room, said)
            yield root if room == "types" else replace(root, also=_KEPT_ALSO, query=(_FORMAT, _PAGE))
            package = self._place(f"/{room}/{{package}}/", room, f"{said} of a package", at=f"/{room}/a/")
            kind = self._place(f"{package.path}{{kind}}/", room, f"{said} of a kind", at=f"/{room}/a/msg/")
            one = self._place(f"{kind.path}{{name}}", room, f"One of the {room}", at=f"/{room}/a/msg/B")
            yield from (replace(package, segments=names), replace(kind, segments=names))
            yield replace(one, segments=names, query=query)
        yield self._place("/shapes/limits", "shapes", "The limits in force")
        yield self._place("/shapes/query", "shapes", "The shape of stored queries")
        kept = self._place("/shapes/{name}", "shapes", "Limits that a client keeps in force", at="/shapes/any")
        methods = READ if self.robot.settings.read_only else READ | {"PUT", "POST", "PATCH", "DELETE"}
        accepts = {"PUT": RDF_BODIES, "POST": kept.accepts.get("POST", ()), "PATCH": (SPARQL_UPDATE, N3_PATCH)}
        yield replace(
            kept,
            methods=methods,
            accepts={method: kinds for method, kinds in accepts.items() if method in methods},
            segments={"name": "One segment, as in the URL."},
            also=_KEPT_ALSO,
        )
        yield self._place("/shapes/mapping", "shapes", "The shape of mapping documents")

    def _bags(self) -> Iterator[Place]:
        space = self.robot.space
        yield self._place("/bags/", "bags", "The recordings")
        for name, recording in self.robot.adapter.recordings.items():
            yield self._place(self._path(space.bag(name)), "bags", f"The recording {name}")
            path = self._path(space.bag_messages(name))
            yield replace(self._place(path, "bags", f"The messages of {name}"), query=(_FORMAT, _PAGE))
            if recording.count:
                message = self._place(f"{path}{{index}}", "bags", f"A message of {name}", at=f"{path}0")
                index = f"From 0 to {recording.count - 1}."
                yield replace(
                    message, reads=_FIELD_READS, plain=ANYTHING, query=(_FORMAT, _FIELD), segments={"index": index}
                )

    def _mappings(self) -> Iterator[Place]:
        """The mapping documents in force, which are kept as data is."""
        yield from self._kept("mappings", "Mapping documents")

    def _data(self) -> Iterator[Place]:
        yield from self._kept("data", "Data that clients keep")

    def _kept(self, room: str, about: str) -> Iterator[Place]:
        """What clients keep. What one URL answers depends on what is there: the template tells of all of it."""
        root = replace(self._place(f"/{room}/", room, about), also=_KEPT_ALSO, pages=True)
        methods = READ if self.robot.settings.read_only else READ | {"PUT", "POST", "PATCH", "DELETE"}
        accepts = {
            "PUT": (*RDF_BODIES, _ANY_TYPE),
            "POST": (*RDF_BODIES, _ANY_TYPE),
            "PATCH": (SPARQL_UPDATE, N3_PATCH, MERGE_PATCH),
        }
        yield root
        yield replace(
            root,
            path=f"/{room}/{{path}}",
            summary="What a client keeps there: RDF, a file, or a container if the path ends in a slash",
            methods=methods,
            reads=(*OFFERS, _ANY_TYPE),
            plain=ANYTHING,
            accepts={method: kinds for method, kinds in accepts.items() if method in methods},
            segments={"path": "One segment or several, with slashes between them."},
        )

    def _stored_queries(self) -> Iterator[Place]:
        """The room of queries and what is below it now; the template tells of those that come and go."""
        yield replace(
            self._place("/queries/", "queries", "The stored queries"), also=_KEPT_ALSO, query=(_FORMAT, _PAGE)
        )
        for url, query in self.robot.queries.all(most=_MOST_QUERIES):
            place = self._place(self._path(url), "queries", query.purpose[:_LONGEST])
            given = (Query(one.name, one.about, _TYPES[one.type], one.default is None) for one in query.parameters)
            yield self._query(replace(place, query=(_RESULT_FORMAT, _TIMEOUT, *given)))
        new = self._place("/queries/{name}", "queries", "A stored query that may be made", at="/queries/any")
        segments = {"name": "One segment, as in the URL."}
        methods = READ if self.robot.settings.read_only else READ | {"PUT", "DELETE"}
        yield self._query(replace(new, methods=methods, segments=segments, query=(_RESULT_FORMAT, _TIMEOUT)))

    def _query(self, place: Place) -> Place:
        return replace(place, reads=(*_RESULTS, DIRECT), plain=ANYTHING, streams=False, also=(409, *_KEPT_ALSO))

    def _sparql(self) -> Place:
        place = self._place("/sparql", "queries", "The SPARQL endpoint")
        updates = UPDATE in place.accepts["POST"]
        form: DataSchema = {
            "type": "object",
            "properties": {"query": TEXT, "default-graph-uri": _GRAPHS, "named-graph-uri": _GRAPHS},
            "required": ["query"],
        }
        update: DataSchema = {
            "type": "object",
            "properties": {"update": TEXT, "using-graph-uri": _GRAPHS, "using-named-graph-uri": _GRAPHS},
            "required": ["update"],
        }
        both, post = frozenset({"POST"}), frozenset({"POST"}) if updates else frozenset()
        return replace(
            place,
            reads=_RESULTS,
            plain=ANYTHING,
            sends={"POST": {"anyOf": [form, update]} if updates else form},
            done={"POST": (200, 204) if updates else (200,)},
            query=(
                Query("query", "A query (SPARQL 1.1 Protocol 2.1); without one the endpoint describes itself."),
                Query("default-graph-uri", "The graphs that are the default graph together.", _GRAPHS, of=both),
                Query("named-graph-uri", "The named graphs.", _GRAPHS, of=both),
                replace(_RESULT_FORMAT, of=both),
                _TIMEOUT,
                *((replace(one, of=post) for one in _OF_UPDATES) if updates else ()),
            ),
        )

    def _graphs(self) -> Place:
        place = self._place("/graphs", "queries", "The graph store: a graph by its name")
        return replace(
            place,
            reads=(*OFFERS, _ANY_TYPE),
            plain=ANYTHING,
            accepts={
                method: (*kinds, *((_ANY_TYPE,) if method == "PUT" else ())) for method, kinds in place.accepts.items()
            },
            query=(
                replace(_GRAPH, of=place.methods),
                replace(_DEFAULT, of=frozenset()),
                replace(_ALL, of=frozenset()),
                replace(_GRAPH_FORMAT, of=place.methods),
            ),
            also=_KEPT_ALSO,
        )

    def _channels(self) -> Iterator[Place]:
        """Notifications (Solid Notifications Protocol 2)."""
        solid = self._place("/.well-known/solid", "channels", "Where the subscription services are")
        told = replace(solid, plain=OBJECT, query=(_FORMAT,))
        yield told
        yield self._place("/.well-known/", "entry", "What is well known here")
        yield self._place("/channels/", "channels", "The subscription services")
        for kind in CHANNEL_TYPES:
            path = f"/channels/{kind}"
            service = replace(self._place(path, "channels", f"Makes channels: {kind}"), plain=OBJECT)
            yield replace(
                service,
                sends={"POST": _SUBSCRIPTION},
                done={"POST": (201,)},
                shows={"POST": OBJECT},
                notes={"POST": "Subscribes to a topic; the answer says where notifications are received from."},
            )
            segments = {"token": "As in the URL of the channel."}
            yield replace(
                told,
                path=f"{path}/{{token}}",
                summary="A channel; without it nothing is told any more",
                methods=READ | {"DELETE"},
                segments=segments,
            )
            yield replace(
                told,
                path=f"{path}/{{token}}/messages",
                summary="Where notifications are received from: by WebSocket, or a response that goes on",
                methods=READ,
                reads=(LINES, "text/turtle", "application/n-triples"),
                plain=None,
                query=(),
                segments=segments,
                streams=False,
                also=(426,),
            )

    def _rest(self) -> Iterator[Place]:
        yield self._place("/ontology", "entry", "The vocabulary")
        yield self._file("/.well-known/wot", "The Thing Description of the whole robot", (THING,))
        yield replace(self._file("/openapi.json", "This description", OPENAPI), query=self._of_listings[1:])
        yield self._file("/style.css", "The style of pages", ("text/css",))
        yield self._file("/live.js", "The script that keeps pages up to date", ("text/javascript",))
        yield self._file("/filter.js", "The script that finds things on long pages", ("text/javascript",))
        yield self._file("/icon.svg", "The icon of pages", ("image/svg+xml",))
        yield self._file("/favicon.ico", "The icon of pages, where browsers look for it", ("image/svg+xml",))

    def _file(self, path: str, summary: str, reads: tuple[str, ...]) -> Place:
        return replace(self._place(path, "entry", summary), reads=reads, plain=OBJECT, query=(), streams=False)
