"""`/space`: a spatial view of topics, and the targets of poses chosen on a map."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator, Mapping, Sequence
from functools import partial

import orjson
from msgspec import Struct
from pyoxigraph import NamedNode
from starlette.responses import Response

from rosld.adapters.model import Graph, Nested, RosError
from rosld.ontology.document import Document
from rosld.ontology.triples import RDF_SOURCE, labelled, statements, triples_about
from rosld.ontology.vocab import dcterms, rdfs
from rosld.server.auth.errors import not_found
from rosld.server.auth.permissions import Permissions
from rosld.server.events.broadcaster import Broadcasters
from rosld.server.events.event_stream import HEADERS
from rosld.server.events.query_params import EVENT_STREAM, stream_is_preferred
from rosld.server.events.space_stream import ShownTopic, SpaceSource, SpaceStream, place_drawing
from rosld.server.html.forms import Form
from rosld.server.html.graphics import VIEW_3D, space_query
from rosld.server.html.page import Csrf, Notice, NoticeLevel, SpacePage, SpaceTopic
from rosld.server.html.render import render_space
from rosld.server.html.site import Site
from rosld.server.http.conditional import digest
from rosld.server.http.problem import Problem
from rosld.server.hypermedia.json_schema import BOOLEAN, NUMBER, TEXT, URI, JsonSchema, json_array, json_object
from rosld.server.pictures.picture_cache import OCCUPANCY_GRID
from rosld.server.resources.actions import ActionResource
from rosld.server.resources.base import Services, SessionResource
from rosld.server.resources.memento import is_recorded
from rosld.server.resources.namespaces import listed_graph
from rosld.server.resources.topics import TopicResource
from rosld.server.rest.exchange import Exchange
from rosld.server.rest.formats import OFFERS
from rosld.server.rest.path_item import FORMAT, PathItem, QueryParameter
from rosld.server.rest.resource import RDF_SOURCE as RDF_SOURCE_LINK
from rosld.server.rest.resource import RESOURCE, Resource
from rosld.server.rest.responses import RawResponse
from rosld.server.rest.state import State
from rosld.server.robot.scene import Scene
from rosld.server.robot.velocity import subscribers_of
from rosld.server.space.drawing import PLACED_TYPES, can_place, kind_label, pose_json
from rosld.server.space.point_cloud import POINT_CLOUD
from rosld.server.space.transforms import TOPICS, FrameBuffer

_POSE, _STAMPED = "geometry_msgs/msg/Pose", "geometry_msgs/msg/PoseStamped"
_MAX_TARGETS = 20


class GoalTarget(Struct, frozen=True):
    """An action or a topic that takes a pose, by `method` at `url`.

    `field` is the field of the message that contains the pose, empty for the whole message; `is_stamped` says whether
    the pose has a header.
    """

    url: str
    name: str
    type: str
    method: str
    field: str
    is_stamped: bool


class GoalTargets:
    """The targets that an agent may send poses to now."""

    def __init__(self, services: Services) -> None:
        self._services = services
        self._session = services.session
        self._found: tuple[Graph, Sequence[GoalTarget]] | None = None

    @property
    def now(self) -> float | None:
        """The time in seconds for the headers of poses, or None if it is simulated."""
        return None if self._session.graph.simulated_time else time.time()

    async def offered(self, permissions: Permissions) -> Sequence[GoalTarget]:
        """Return the offered targets, actions first; none while the robot is stopped."""
        graph = self._session.graph
        if self._found is None or self._found[0] is not graph:
            self._found = graph, [each async for each in self._targets(graph)]
        found = [each for each in self._found[1] if permissions.may(each.method, each.url) and self._is_open(each)]
        return found[:_MAX_TARGETS]

    def _is_open(self, target: GoalTarget) -> bool:
        resource = (ActionResource if target.method == "POST" else TopicResource)(self._services, target.name)
        return target.method in resource.methods() - resource.withheld

    async def _targets(self, graph: Graph) -> AsyncIterator[GoalTarget]:
        """Return all targets that take a pose, regardless of permissions."""
        space, listed = self._session.space, listed_graph(graph, self._session.adapter.capabilities)
        for name, action in sorted(listed.actions.items()):
            if action.type is None:
                continue
            try:
                schema = await self._session.schemas.action(action.type)
            except RosError:
                continue
            poses = [
                (each.name, each.type.name == _STAMPED)
                for each in schema.goal.type.fields
                if isinstance(each.type, Nested) and each.type.name in (_POSE, _STAMPED)
            ]
            if len(poses) == 1:
                yield GoalTarget(space.action(name), name, action.type.name, "POST", *poses[0])
        for name, topic in sorted(listed.topics.items()):
            if topic.type is not None and topic.type.name == _STAMPED and subscribers_of(topic, graph):
                yield GoalTarget(space.topic(name), name, _STAMPED, "PUT", "", is_stamped=True)


MAX_SHOWN = 32
"""Maximum number of topics in a view."""
_MAX_REFERENCE = 1000
_MAX_FRAME = 300
_GRID_WIDTH = 2048
"""Maximum width of the picture of a grid; for a grid four times as wide, a pixel stands for sixteen cells."""
_MODEL, _STRING = "/robot_description", "std_msgs/msg/String"
_ODOMETRY = "nav_msgs/msg/Odometry"
_VIEWS = ("above", VIEW_3D)
_PARAMETERS = (
    QueryParameter("frame", "The fixed frame of the view. Default: the frame of the map if there is one."),
    QueryParameter(
        "show",
        "A topic to draw: its URL, absolute or below the base. Repeatable. Default: all topics.",
        {"type": "array", "items": TEXT},
    ),
    QueryParameter(
        "view", "The view on the page: `above`, or `3d` in three dimensions.", {"type": "string", "enum": [*_VIEWS]}
    ),
    FORMAT,
)
_PLAIN: JsonSchema = json_object(
    {
        "frame": {"type": ["string", "null"]},
        "show": json_array(
            json_object(
                {
                    "topic": URI,
                    "kind": TEXT,
                    "frame": TEXT,
                    "pose": {"anyOf": [json_array(NUMBER), {"type": "null"}]},
                    "problem": TEXT,
                }
            )
        ),
        "goals": json_array(
            json_object(
                {
                    "url": URI,
                    "name": TEXT,
                    "type": TEXT,
                    "method": {"type": "string", "enum": ["POST", "PUT"]},
                    "field": TEXT,
                    "stamped": BOOLEAN,
                }
            )
        ),
    }
)


class SpaceResource(SessionResource):
    """A view of the requested topics, or of all drawable ones, with the permissions of one agent."""

    kind = "View of space"
    shape = "Source"
    title = "Space"
    item = PathItem("The surroundings of the robot", (*OFFERS, EVENT_STREAM), _PLAIN, query=_PARAMETERS, streams=False)
    links = (RESOURCE, RDF_SOURCE_LINK)
    is_cacheable = False
    frame = ""
    references: tuple[str, ...] = ()
    is_3d = False

    path = "space"
    _topics: Sequence[SpaceTopic] = ()
    _frames: Sequence[str] = ()
    _fixed = ""

    def __init__(self, services: Services, scene: Scene, broadcasters: Broadcasters, goals: GoalTargets) -> None:
        super().__init__(services)
        self.scene = scene
        self._broadcasters = broadcasters
        self._goals = goals

    async def select_variant(self, exchange: Exchange) -> Resource:
        """Return the view selected by `frame` and `show`, with the agent's permissions. Raises Problems."""
        references = exchange.query_values("show")
        if len(references) > MAX_SHOWN:
            raise Problem(
                400, f"?show= is given {len(references)} times: at most {MAX_SHOWN} topics can be drawn together."
            )
        frame = exchange.query.get("frame", "").strip().removeprefix("/")
        if len(frame) > _MAX_FRAME:
            raise Problem(400, f"?frame={frame[:60]}... is too long.")
        view = exchange.query.get("view", "above")
        if view not in _VIEWS:
            raise Problem(400, f"?view={view[:60]}: there are {' and '.join(_VIEWS)}.")
        is_3d = view == VIEW_3D
        return self.variant(
            url=self.url + space_query(frame, references, is_3d=is_3d),
            frame=frame,
            references=tuple(references),
            is_3d=is_3d,
            _permissions=exchange.permissions,
        )

    def document(self) -> Document:
        """Return the document without a selection."""
        return _document(self.url, ())

    async def state(self) -> State:
        graph = self.session.graph
        names = self._topics_to_show(graph) or self._all(graph)[:MAX_SHOWN]
        await asyncio.gather(*(self.session.topics.read(name) for name in names))
        buffer = await self.scene.frames.look() if self._may_read_frames else FrameBuffer()
        drawings = [await self.scene.drawings.newest(name) for name in names]
        first = (each.drawing.frame for each in drawings if each and each.drawing)
        self._fixed = self.frame or buffer.default_frame() or next(first, "")
        self._frames = tuple(buffer.names)
        topics = []
        for name, each in zip(names, drawings, strict=True):
            url, kind = self.space.topic(name), _kind(graph, name)
            if each is None:
                topics.append(SpaceTopic(url, kind, "", None, "No message received yet"))
                continue
            pose, problem = place_drawing(each, buffer, self._fixed)
            topics.append(SpaceTopic(url, kind, each.drawing.frame if each.drawing else "", pose, problem))
        self._topics = topics
        goals = [_target_json(each, each.url) for each in await self._goals.offered(self._permissions)]
        plain = orjson.dumps(
            {"frame": self._fixed or None, "show": [_topic_json(each) for each in topics], "goals": goals}
        )
        return State(partial(_document, self.url, [each.url for each in topics]), lambda: plain, digest(plain))

    async def custom_get(self, exchange: Exchange) -> Response | None:
        """Return the event stream of the view, if requested."""
        if not stream_is_preferred(exchange.accept, OFFERS):
            return None
        names = self._topics_to_show(self.session.graph)
        if exchange.method == "HEAD":
            return RawResponse(200, b"", HEADERS)
        self._broadcasters.require_capacity(exchange.request.client)
        source = SpaceSource(
            self.session.topics,
            self.scene.drawings,
            self.scene.frames if self._may_read_frames else None,
            lambda: self._shown_topics(self.session.graph, names),
            exchange.auth.is_valid,
            self._sent_goals,
            self.is_3d,
        )
        return SpaceStream(self._broadcasters, source, self.frame)

    async def _sent_goals(self) -> tuple[Sequence[Mapping[str, object]], float | None]:
        """Return the targets of poses, as references relative to the host, and the time for their headers."""
        space = self.space
        found = await self._goals.offered(self._permissions)
        targets = [_target_json(each, space.path + each.url.removeprefix(space.base)) for each in found]
        return targets, self._goals.now

    def page(self, site: Site, state: State, forms: Sequence[Form], csrf: Csrf, notices: Sequence[Notice]) -> bytes:
        graph, notes = self.session.graph, list(notices)
        if not self._may_read_frames:
            notes.append(Notice("You may not read the transforms between frames.", NoticeLevel.WARNING))
        elif not self._frames:
            notes.append(Notice("No transforms between frames are published, on /tf or on /tf_static."))
        elif self.frame and self.frame not in self._frames:
            known = ", ".join(self._frames[:20])
            notes.append(Notice(f"There is no frame called {self.frame}: there are {known}.", NoticeLevel.WARNING))
        return render_space(
            SpacePage(
                site,
                self.url,
                tuple(self._topics),
                self._fixed,
                self.frame,
                self.references,
                tuple(self._frames[:1000]),
                0 if self.references else max(len(self._all(graph)) - MAX_SHOWN, 0),
                tuple(notes),
                self.is_3d,
                self._model(graph) if self.is_3d else "",
            )
        )

    @property
    def _may_read_frames(self) -> bool:
        space = self.space
        return all(self._permissions.may_read(space.topic(each)) for each in TOPICS)

    def _model(self, graph: Graph) -> str:
        """Return the source of the robot's model: a topic (ROS 2) or a parameter (ROS 1), or empty."""
        space = self.space
        topic, url = graph.topics.get(_MODEL), space.topic(_MODEL)
        if (
            topic is not None
            and topic.type is not None
            and topic.type.name == _STRING
            and self._permissions.may_read(url)
        ):
            return f"{url}?field=data"
        parameter, url = graph.parameters.get(_MODEL), space.parameter(_MODEL)
        if parameter is not None and parameter.node is None and self._permissions.may_read(url):
            return url
        return ""

    def _all(self, graph: Graph) -> list[str]:
        """Return the drawable topics that the agent may read, in drawing order."""
        space, topics = self.space, listed_graph(graph, self.session.adapter.capabilities).topics
        found = [
            (PLACED_TYPES.index(topic.type.name), name)
            for name, topic in topics.items()
            if topic.type is not None and can_place(topic.type.name) and self._permissions.may_read(space.topic(name))
        ]
        return [name for _, name in sorted(found)]

    def _topics_to_show(self, graph: Graph) -> list[str]:
        """Return the topics that `show` names. Raises Problems."""
        return [self._topic_of(graph, each) for each in self.references]

    def _topic_of(self, graph: Graph, reference: str) -> str:
        space = self.space
        if len(reference) > _MAX_REFERENCE:
            raise Problem(400, f"?show={reference[:60]}... is too long.")
        url = space.absolute(reference)
        location = None if "?" in url or "#" in url else space.location(url)
        if location is None or location.is_container or location.kind != "topics":
            raise Problem(400, f"?show={reference[:100]} does not name a topic of this robot, such as topics/scan.")
        if not self._permissions.may_read(url):
            raise not_found()
        topic = graph.topics.get(location.name)
        if topic is None:
            raise Problem(404, f"There is no topic {location.name}.")
        if topic.type is None or not can_place(topic.type.name):
            types_text = "several types" if topic.type is None else topic.type.name
            raise Problem(
                422,
                f"{location.name} has messages of {types_text}: only {', '.join(PLACED_TYPES)} can be drawn in space.",
            )
        return location.name

    def _shown_topics(self, graph: Graph, names: Sequence[str]) -> list[ShownTopic]:
        """Return these topics for the stream, or all drawable ones up to the limit."""
        return [self._shown_topic(graph, name) for name in names or self._all(graph)[:MAX_SHOWN]]

    def _shown_topic(self, graph: Graph, name: str) -> ShownTopic:
        """Return a topic for the stream."""
        space, url = self.space, self.space.topic(name)
        topic = graph.topics.get(name)
        type_name = topic.type.name if topic is not None and topic.type is not None else ""
        href = space.path + url.removeprefix(space.base)
        picture = f"{href}?format=png&width={_GRID_WIDTH}" if type_name == OCCUPANCY_GRID else ""
        has_history = type_name == _ODOMETRY and is_recorded(self.services.history, name)
        history = f"{href}?series=pose.pose.position." if has_history else ""
        cloud = f"{href}?format=ply" if type_name == POINT_CLOUD else ""
        return ShownTopic(name.encode("utf-8", "replace").decode(), _kind(graph, name), href, picture, history, cloud)


def _kind(graph: Graph, name: str) -> str:
    topic = graph.topics.get(name)
    is_known = topic is not None and topic.type is not None and can_place(topic.type.name)
    return kind_label(topic.type.name) if topic and topic.type and is_known else ""


def _topic_json(topic: SpaceTopic) -> dict[str, object]:
    pose = None if topic.pose is None else pose_json(topic.pose)
    return {"topic": topic.url, "kind": topic.kind, "frame": topic.frame, "pose": pose, "problem": topic.problem}


def _target_json(target: GoalTarget, reference: str) -> dict[str, object]:
    return {
        "url": reference,
        "name": target.name.encode("utf-8", "replace").decode(),
        "type": target.type,
        "method": target.method,
        "field": target.field,
        "stamped": target.is_stamped,
    }


def _document(url: str, topics: Sequence[str]) -> Document:
    """Return the topics of the view as RDF."""
    links = statements(rdfs.seeAlso, (NamedNode(each) for each in topics))
    return Document(url, tuple(triples_about(NamedNode(url), *RDF_SOURCE, *labelled(dcterms.title, "Space"), *links)))
