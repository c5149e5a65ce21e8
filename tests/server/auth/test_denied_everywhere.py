"""Resources denied to a reader are mentioned in no route, syntax, query, stream, file or link, and in no refusal.

The robot and everything that an administrator creates on it has names with `zq7x9`, and the number 7317.25; the topics
and services behind the property `/grip` have other names. The reader may read all other paths, the writer may write
them as well. Documents of clients (`/data/`, `/mappings/`, `/queries/`, `/cockpit/`, and `/shapes/`) are not redacted
literally: those here name denied resources by URLs, which are omitted.
"""

from __future__ import annotations

import asyncio
import contextlib
import html
import io
import json
import re
import time
from collections import Counter
from collections.abc import AsyncIterator, Iterable, Mapping, Sequence, Set
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from urllib.parse import quote, unquote

import pytest
from mcap.reader import NonSeekingReader

from rosld.adapters.base import Capabilities, Sink, Watch
from rosld.adapters.model import (
    Action,
    ActionSchema,
    Encoding,
    Endpoint,
    GoalEvent,
    GoalId,
    GoalStatus,
    Graph,
    Kind,
    Node,
    Operation,
    Ref,
    Refused,
    TypeRef,
    freeze,
)
from rosld.ontology.lift import LiftSettings
from rosld.ontology.lower import lowerer
from rosld.server.app import Application, create_app
from rosld.server.resources.entry_point import FILES
from rosld.server.serving.lifespan import lifespan
from rosld.server.settings import Settings
from tests.server.auth.conftest import rule, token, tokens
from tests.server.events.conftest import HOST, Reader
from tests.server.robots.made_up import MadeUp

MARKER = re.compile(r"zq7x9\w*|7317\.25|7\.31725|[gs]et_grip")
PARTS_OF_MARKERS = ("zq7x9", "7317.25", "7.31725", "et_grip")
"""Much faster to look for than the pattern; no escape of HTML, URLs or JSON changes them."""
NUMBER = 7317.25
BASE = f"http://{HOST.decode()}/"
RULES = (
    rule("admin", "read write control administer", "/**")
    + rule("reader", "read", "/**")
    + rule("writer", "read write control", "/**")
    + rule("reader writer", "read write control", "/**/*zq7x9*", "/**/*zq7x9*/**", "/services/*et_grip", deny=True)
)
DENIED_NODE = "/zq7x9_node"
TURN = "float64 angle\n---\nstring words\n---\nfloat64 left"
SYNTAXES = (
    "text/turtle", "application/ld+json", "application/n-triples", "application/rdf+xml", "text/n3", "application/trig",
    "application/n-quads", "application/json", "text/html", "image/svg+xml", "text/vnd.graphviz", "text/csv",
    "application/td+json", "application/vnd.oai.openapi+json", "application/sparql-results+json", "*/*",
)  # fmt: skip
SAMPLES: Mapping[str, tuple[str, ...]] = {
    "": ("/",),
    "nodes": ("/nodes/", "/nodes/robot", "/nodes/zq7x9_node"),
    "topics": (
        "/topics/", "/topics/open", "/topics/shared", "/topics/zq7x9_speed", "/topics/zq7x9_never", "/topics/opn",
        "/topics/open?series=data", "/topics/zq7x9_speed?series=data", "/topics/open?timemap", "/topics/open?at=-0.01",
        "/topics/open?shape", "/topics/zq7x9_image?format=jpeg", "/topics/open?until=data%20%3E%2099999&timeout=0.01",
    ),
    "services": ("/services/", "/services/open_service", "/services/zq7x9_service", "/services/zq7x9_servic"),
    "calls": ("/calls/", "/calls/never"),
    "actions": ("/actions/", "/actions/open_action", "/actions/zq7x9_action"),
    "goals": ("/goals/", "/goals/never"),
    "activity": ("/activity/", "/activity/never", "/activity/?page=5:"),
    "holds": ("/holds/", "/holds/never"),
    "faults": ("/faults/", "/faults/never"),
    "parameters": ("/parameters/", "/parameters/open/", "/parameters/zq7x9_tree/", "/parameters/open/numbr"),
    "types": ("/types/", "/types/std_msgs/msg/Float64"),
    "shapes": ("/shapes/", "/shapes/std_msgs/msg/Float64", "/shapes/limits", "/shapes/resources", "/shapes/documents"),
    "bags": (
        "/bags/", "/bags/done", "/bags/done/", "/bags/done/file", "/bags/done/messages/", "/bags/done/messages/?page=0",
        "/bags/done/messages/?start=0", "/bags/done/messages/?topic=/zq7x9_speed", "/bags/done/messages/?topic=*",
        "/bags/done/messages/?topic=/zq7x9_speed&format=csv", "/bags/done/messages/?topic=*&format=csv",
        "/bags/done/messages/?topic=/never", "/bags/done/at", "/bags/done/at?topic=/zq7x9_speed", "/bags/done/ldes",
        "/bags/sent/", "/bags/sent/file", "/bags/sent/at", "/bags/sent/messages/?start=0", "/bags/running/",
        "/bags/running/file", "/bags/armed/", "/bags/mapped/", "/bags/history/", "/bags/history/file",
        "/bags/history/at?time=-0.001", "/bags/history/messages/?page=0", "/bags/history/messages/?start=0",
        "/bags/history/ldes", "/bags/open/", "/bags/open/file", "/bags/never/", "/bags/done/ldes?profile=sosa",
    ),
    "resources": ("/resources/", "/resources/open", "/resources/open?at=-0.01", "/resources/car/",
                  "/resources/zq7x9_speed"),
    "data": ("/data/", "/data/plan", "/data/zq7x9/document", "/data/box/", "/data/plan?timemap"),
    "mappings": ("/mappings/",),
    ".well-known": ("/.well-known/", "/.well-known/wot", "/.well-known/solid", "/.well-known/wot?below=/topics/"),
    "stop": ("/stop",),
    "graph": ("/graph", "/graph?all=true", "/graph?below=/zq7x9_node", "/graph?format=svg", "/graph?format=dot"),
    "diagnostics": ("/diagnostics", "/diagnostics?name=zq7x9%20motor", "/diagnostics?name=motor"),
    "llms.txt": ("/llms.txt",),
    "docs": ("/docs/", "/docs/?q=topics", "/docs/how-to/trouble"),
    "ontology": ("/ontology",),
    "sparql": ("/sparql",),
    "queries": ("/queries/", "/queries/graph"),
    "cockpit": ("/cockpit/", "/cockpit/default", "/cockpit/kept", "/cockpit/kept?format=html"),
    "asyncapi.json": ("/asyncapi.json",),
    "openapi.json": ("/openapi.json", "/openapi.json?below=/topics/", "/openapi.json?below=/bags/"),
    "find": (
        "/find", "/find?q=zq", "/find?q=open", "/find?q=speed&values=true", "/find?q=Float64&values=true",
        "/find?q=shared", "/find?q=message", "/find?q=done", "/find?q=denied",
    ),
    "graphs": ("/graphs", "/graphs?default"),
    "channels": ("/channels/", "/channels/StreamingHTTPChannel2023", "/channels/WebSocketChannel2023"),
    "plot": ("/plot", "/plot?y=topics/open%23data", "/plot?y=topics/zq7x9_speed%23data"),
    "space": ("/space", "/space?show=topics/zq7x9_scan", "/space?view=3d", "/space?frame=zq7x9_frame"),
    "status": ("/status",),
    "metrics": ("/metrics",),
    "healthz": ("/healthz",),
    "readyz": ("/readyz",),
    "frames": ("/frames",),
    "body": ("/body",),
    "acl": ("/acl",),
}  # fmt: skip
"""Start of the crawl in each route: a new route has to be added here."""
VARIANTS = (
    "offer",
    "format=json",
    "format=html",
    "hidden=true",
    "timemap",
    "at=-0.01",
    "page=0",
    "shape",
    "values=true",
)
IN_FULL, AS_PAGES = 1, 3
"""Documents of a kind read in all syntaxes and variants, like the samples, and as pages; others as triples."""
WRITES = (
    ("PUT", b"{nonsense", "application/json"),
    ("PATCH", b"<> <", "application/sparql-update"),
    ("POST", b"{}", "application/json"),
    ("DELETE", b"", ""),
)
"""Writes that are all refused to the reader."""
QUERIES = (
    "SELECT * { ?s ?p ?o }",
    "SELECT * { GRAPH ?g { ?s ?p ?o } }",
    "SELECT (GROUP_CONCAT(STR(?o)) AS ?all) { GRAPH ?g { ?s ?p ?o } }",
    "CONSTRUCT { ?s ?p ?o } { ?s ?p ?o }",
    "CONSTRUCT { GRAPH ?g { ?s ?p ?o } } WHERE { GRAPH ?g { ?s ?p ?o } }",
    "DESCRIBE ?x { ?x ros:name ?n }",
    "SELECT * { ?topic ros:past ?m . ?m ?p ?o }",
    "SELECT * { ?topic ros:past ?m . ?r ros:recordedMessage ?m ; ?p ?o }",
    "SELECT * { ?m ros:recordedIn </bags/done/> . ?topic ros:past ?m . ?m ?p ?o }",
    "SELECT * { ?x a ros:ComplexResource ; ?p ?o }",
    "SELECT * { ?x a ros:Property ; ?p ?o }",
    "SELECT * { ?x a ros:Write ; ?p ?o . OPTIONAL { ?o ?q ?r } }",
    "SELECT * { ?x a ros:Parameter ; ?p ?o }",
    "SELECT * { ?x ros:rate ?rate ; ros:briefValue ?value }",
    "SELECT * { GRAPH ?g { ?x ldp:contains ?y } }",
    "ASK { ?s ?p ?o FILTER(CONTAINS(STR(?o), 'zq7x9')) }",
)
RESULTS = ("application/sparql-results+json", "text/csv", "text/html", "application/n-triples", "application/ld+json")


class Secretive(MadeUp):
    """A simulated robot with actions, a node that must not be mentioned, and denied resources of every kind."""

    capabilities = Capabilities("made-up", Encoding.ROS1, writes=True, creates_topics=True, parameter_trees=True)

    def __init__(self) -> None:
        super().__init__()
        self.sink: Sink | None = None
        self.turn: ActionSchema = self._library.learn_action("made_up/action/Turn", TURN)
        for name in ("open", "zq7x9"):
            self.answer(f"/{name}_service", "std_srvs/srv/Trigger", success=True, message=f"{name}answered")
            self.strange(Action(f"/{name}_action", self.turn.ref, ("/robot",)))
        self.strange(Action("/shared_action", self.turn.ref, ("/robot", DENIED_NODE)))
        self.variable("/grip", "Byte", value=1)
        for type, name in (("Get", "/get_grip"), ("Set", "/set_grip")):
            self.offer(name, f"made_up/srv/{type}Byte", _refuse)
        self.parameter("/open/number", 1)
        self.parameter("/open/limited", 1)
        self.parameter("/zq7x9_tree/leaf", "zq7x9leaf")
        self.parameter("/open/zq7x9_inner", "zq7x9inner")
        self.topic("/open", "std_msgs/msg/Float64", {"data": 1.5})
        self.topic("/shared", "std_msgs/msg/Float64", {"data": 2.5}, heard=True)
        self.topic("/cmd_vel", "geometry_msgs/msg/Twist", heard=True, published=False)
        self.topic("/zq7x9_cmd", "geometry_msgs/msg/Twist", heard=True, published=False)
        self.topic("/zq7x9_speed", "std_msgs/msg/Float64", {"data": NUMBER}, heard=True)
        self.topic("/zq7x9_words", "std_msgs/msg/String", {"data": "zq7x9said"}, heard=True, published=False)
        self.topic("/open_words", "std_msgs/msg/String", heard=True, published=False)
        urdf = {"data": '<robot name="zq7x9_robot"><link name="zq7x9_link"/></robot>'}
        self.topic("/zq7x9/robot_description", "std_msgs/msg/String", urdf)
        self.topic("/joints", "sensor_msgs/msg/JointState", {"name": ["open"], "position": [1.0]})
        self.topic("/battery", "sensor_msgs/msg/BatteryState", {"voltage": 12.0})
        self.topic("/zq7x9_battery", "sensor_msgs/msg/BatteryState", {"voltage": NUMBER})
        scan = {"angle_max": 1.0, "angle_increment": 0.5, "range_max": 9000.0, "ranges": [1.0, NUMBER, 2.0]}
        self.topic("/scan", "sensor_msgs/msg/LaserScan", {**scan, "header": {"frame_id": "base"}, "ranges": [1, 2, 3]})
        self.topic("/zq7x9_scan", "sensor_msgs/msg/LaserScan", {**scan, "header": {"frame_id": "zq7x9_frame"}})
        image = {"height": 1, "width": 1, "encoding": "mono8", "step": 1, "data": [7]}
        self.topic("/zq7x9_image", "sensor_msgs/msg/Image", {**image, "header": {"frame_id": "zq7x9_camera"}})
        for name in ("", "zq7x9_"):
            status = [{"name": f"{name.replace('_', ' ')}motor", "message": f"{name}fine", "hardware_id": f"{name}id"}]
            self.topic(f"/{name}diagnostics", "diagnostic_msgs/msg/DiagnosticArray", {"status": status})
        transform = {"header": {"frame_id": "map"}, "child_frame_id": "base", "transform": {"rotation": {"w": 1.0}}}
        self.topic("/tf", "tf2_msgs/msg/TFMessage", {"transforms": [transform]})
        self.publishes("/tf", {"transforms": [transform]})

    async def open(self, sink: Sink, *, deadline: float) -> None:
        self.sink = sink
        await super().open(sink, deadline=deadline)

    async def schema(self, ref: TypeRef, *, deadline: float) -> Any:
        return self.turn if ref.name == self.turn.ref.name else await super().schema(ref, deadline=deadline)

    def allows(self, ref: Ref) -> frozenset[Operation]:
        if ref.kind is Kind.TOPIC:
            return frozenset({Operation.SUBSCRIBE, Operation.PUBLISH})
        return super().allows(ref)

    async def send_goal(self, action: str, type: TypeRef, goal: bytes, *, deadline: float) -> GoalId:
        """Accept a goal, report it, and let it succeed; a goal below zero continues."""
        id = GoalId(action, f"{len(self.sent)}{abs(hash(goal)):x}{len(action)}")
        self._tell(id, GoalEvent(time.time_ns(), GoalStatus.ACCEPTED, goal=goal, own=True))
        left = self._turned("feedback", {"left": NUMBER if "zq7x9" in action else 1.0})
        self._tell(id, GoalEvent(time.time_ns(), GoalStatus.EXECUTING, feedback=left, own=True))
        words = f"{action[1:4]}turned"
        self._tell(
            id,
            GoalEvent(
                time.time_ns(), GoalStatus.SUCCEEDED, words, result=self._turned("result", {"words": words}), own=True
            ),
        )
        return id

    async def cancel_goal(self, goal: GoalId, *, deadline: float) -> None:
        self._tell(goal, GoalEvent(time.time_ns(), GoalStatus.CANCELED, own=True))

    async def cancel_goals(self, action: str, *, deadline: float) -> None:
        pass

    async def follow_goals(self, action: str, *, deadline: float) -> Watch:
        return ExitStack()

    def _tell(self, id: GoalId, event: GoalEvent) -> None:
        if self.sink is not None:
            self.sink.goal_changed(id, event)

    def _turned(self, part: str, value: Mapping[str, object]) -> bytes:
        schema = getattr(self.turn, part)
        return schema.codec.encode(
            lowerer(schema, LiftSettings(inline_limit=1 << 62)).from_json(dict(value), defaults=True), Encoding.ROS1
        )

    def _announce(self, graph: Graph) -> None:
        """Publish the graph with a denied node, which has a permitted topic and subscribes to it."""
        topics = dict(graph.topics)
        shared = topics.get("/shared")
        if shared is not None and shared.type is not None:
            ends = (Endpoint(DENIED_NODE, shared.type), Endpoint("/robot", shared.type))
            topics["/shared"] = replace(shared, publishers=ends, subscribers=ends)
        nodes = {**graph.nodes, DENIED_NODE: Node(DENIED_NODE)}
        super()._announce(replace(graph, topics=freeze(topics), nodes=freeze(nodes)))

    def _put(self, name: str, publisher: str, data: bytes) -> None:
        super()._put(name, DENIED_NODE if name == "/shared" else publisher, data)


def _refuse(_: object) -> Mapping[str, Any]:
    raise Refused("the gripper refuses", words="zq7x9said")


@dataclass
class Answer:
    """The response to a request: its head in words, its body."""

    request: str
    status: int
    headers: dict[str, str]
    body: bytes

    @property
    def text(self) -> str:
        """Return head and body as text, including the messages of a recording's file."""
        head = "\n".join([str(self.status), *map(": ".join, self.headers.items())])
        inflated = _inflated(self.body) if self.body.startswith(b"\x89MCAP") else b""
        return f"{head}\n{(self.body + inflated).decode('utf-8', 'replace')}"

    @property
    def leaks(self) -> set[str]:
        """Return the denied names and values in it, except those in the request."""
        said = self.text
        if not any(each in said for each in PARTS_OF_MARKERS):
            return set()
        found = set(MARKER.findall(said))
        named = unquote(unquote(self.request))
        return {each for each in found if each not in named and each not in LITERAL}


LITERAL = frozenset({"zq7x9_asked"})
"""Resources that a stored query names in its text, which readers of the query may read."""


def _inflated(data: bytes) -> bytes:
    """Return the decompressed records of an MCAP file."""
    reader = NonSeekingReader(io.BytesIO(data))
    return b"\n".join(
        b"%s %s" % (channel.topic.encode(), message.data) for _, channel, message in reader.iter_messages()
    )


class Request(Reader):
    """A request of an agent, with the part of its response received so far."""

    def __init__(
        self, app: Application, agent: str, method: str, path: str, body: bytes, headers: dict[str, str]
    ) -> None:
        super().__init__(app, path, {"authorization": f"Bearer {token(agent)}", **headers}, method, body)
        self._words = f"{method} {path} {body.decode('utf-8', 'replace')}"

    @property
    def answer(self) -> Answer:
        return Answer(self._words, self.status, self.headers, b"".join(self.chunks))

    async def hear(self, words: bytes, count: int = 1, seconds: float = 10.0) -> None:
        """Wait until a text was received this many times, the response is complete, or the time is over."""
        coming = asyncio.ensure_future(self.until(lambda _: self.answer.body.count(words) >= count, seconds))
        await asyncio.wait({self.task, coming}, timeout=seconds, return_when=asyncio.FIRST_COMPLETED)
        coming.cancel()

    async def finish(self) -> Answer:
        """Return the complete response."""
        await asyncio.wait_for(self.task, 60)
        return self.answer

    async def hang_up(self) -> Answer:
        """Disconnect; return the part received until then."""
        await self.leave()
        return self.answer


class Client:
    """Requests of one agent; `statuses` are counted."""

    def __init__(self, app: Application, agent: str) -> None:
        self._app = app
        self._agent = agent
        self.statuses: Counter[int] = Counter()

    def begin(self, method: str, path: str, body: bytes = b"", **headers: str) -> Request:
        """Start a request."""
        sent = {name.replace("_", "-").lower(): value for name, value in headers.items()}
        return Request(self._app, self._agent, method, path, body, sent)

    async def __call__(self, method: str, path: str, body: bytes = b"", **headers: str) -> Answer:
        """Return the response; of an event stream (as of a channel) its first event, if there is one soon."""
        request = self.begin(method, path, body, **headers)
        if headers.get("Accept") == "text/event-stream" or path.startswith("/channels/"):
            await request.hear(b"data:", seconds=0.2)
            answer = await request.hang_up()
        else:
            answer = await request.finish()
        self.statuses[answer.status] += 1
        return answer


PREFIXES = """# {padding}
@prefix map: <https://w3id.org/rosld/mapping#> . @prefix ros: <https://w3id.org/rosld#> . @prefix ex: <http://e.x/> .
@prefix sh: <http://www.w3.org/ns/shacl#> . @prefix rdf: <http://www.w3.org/1999/02/22-rdf-syntax-ns#> .
@prefix dcterms: <http://purl.org/dc/terms/> . @prefix rdfs: <http://www.w3.org/2000/01/rdf-schema#> .
""".replace("{padding}", "x" * 300)
"""They are longer than the excerpts of receipts, so that these do not contain the documents."""
MAPPING = """
<#car> a map:ComplexResource ; map:path "/car/" ; rdfs:label "The car" ;
  map:property [ map:predicate ex:speed ; map:name "speed" ; map:member "/zq7x9_speed" ] ,
    [ map:predicate ex:open ; map:member "/open" ; map:writableWhen <#low> ] ,
    [ map:predicate ex:leaf ; map:name "leaf" ; map:member "/zq7x9_tree/leaf" ] ;
  map:action [ map:relation ex:act ; map:name "act" ; map:service "/zq7x9_service" ] ,
    [ map:relation ex:turn ; map:name "turn" ; map:service "/open_service" ; map:availableWhen <#low> ] ;
  map:stop [ map:publish "/zq7x9_words" ; map:content '{"data": "zq7x9stopped"}' ] .
<#low> a sh:NodeShape ; map:about "/zq7x9_tree/leaf" ; sh:property [ sh:path rdf:value ;
  sh:hasValue "zq7x9never" ; sh:message "zq7x9 is low" ] .
"""
PLAN = "<> ex:about </topics/zq7x9_speed>, </bags/done/file> ; ex:says 'open' ."
KEPT = """<> a ros:Cockpit ; dcterms:title "Kept" ;
  ros:hasPanel [ a ros:ValuePanel ; ros:shows </topics/open> ; dcterms:title "Open" ] ,
  [ a ros:PlotPanel ; ros:shows </topics/zq7x9_speed> ; dcterms:title "zq7x9 titled" ] .
"""
LIMITS = """
<#limit> a sh:NodeShape ; sh:targetNode </resources/zq7x9_speed> ;
  sh:property [ sh:path rdf:value ; sh:maxInclusive 7317.25 ] .
<#limited> a sh:NodeShape ; sh:targetNode </parameters/open/limited> ;
  sh:property [ sh:path ros:value ; sh:maxInclusive 10 ] .
"""
ASKED = "# The value of a topic.\nSELECT ?s ?o { GRAPH </topics/zq7x9_asked> { ?s ?p ?o } }"
JSON = "application/json"
TURTLE = "text/turtle"


async def fill(admin: Client, robot: Secretive) -> list[str]:
    """Do everything possible as an administrator, on denied and other resources; return the paths of holds."""

    async def do(method: str, path: str, status: int, body: object = None, kind: str = JSON) -> Answer:
        text = body if isinstance(body, str | bytes) else "" if body is None else json.dumps(body)
        data = text if isinstance(text, bytes) else text.encode()
        answer = await admin(method, path, data, Content_Type=kind)
        assert answer.status == status, (method, path, answer.status, answer.body)
        return answer

    twist = {"linear": {"x": 0.0}}
    await do("PUT", "/mappings/zq7x9_car", 201, PREFIXES + MAPPING, TURTLE)
    await do("PUT", "/data/plan", 201, PREFIXES + PLAN, TURTLE)
    await do("PUT", "/data/box/open", 201, PREFIXES + "<> ex:says 1 .", TURTLE)
    await do("PUT", "/data/zq7x9/document", 201, PREFIXES + "<> ex:says 'zq7x9text' .", TURTLE)
    await do("PUT", "/cockpit/kept", 201, PREFIXES + KEPT, TURTLE)
    await do("PUT", "/shapes/zq7x9_limits", 201, PREFIXES + LIMITS, TURTLE)
    await do("PUT", "/queries/asked", 201, ASKED, "application/sparql-query")
    await do("PUT", "/queries/zq7x9_query", 201, "# zq7x9purpose\nSELECT * { ?s ?p ?o }", "application/sparql-query")
    for name in ("open", "zq7x9"):
        await do("POST", f"/services/{name}_service", 201, {})
        await do("POST", f"/actions/{name}_action", 201, {"angle": NUMBER if name == "zq7x9" else 1.0})
    await do("PUT", "/topics/zq7x9_words", 204, {"data": "zq7x9written"})
    await do("PUT", "/topics/open_words", 204, {"data": "said"})
    await do("PUT", "/parameters/zq7x9_tree/leaf", 204, "zq7x9parameter".join('""'))
    await do("PUT", "/parameters/zq7x9_tree/more", 201, NUMBER)
    await do(
        "PATCH", "/parameters/open/", 204, {"number": 2, "zq7x9_inner": "zq7x9patched"}, "application/merge-patch+json"
    )
    await do("PUT", "/parameters/zq7x9_refused", 400, "{zq7x9bad")
    await do("PUT", "/topics/zq7x9_nothing", 404, "{zq7x9worse")
    await do("PUT", "/topics/shared", 405, {"data": 1})
    await do("POST", "/sparql", 204, "INSERT DATA { GRAPH </data/zq7x9/document> { <#x> <http://e.x/p> 'zq7x9new' } }",
             "application/sparql-update")  # fmt: skip
    await do("POST", "/sparql", 204, "INSERT DATA { GRAPH </data/box/open> { <#x> <http://e.x/p> 2 } }",
             "application/sparql-update")  # fmt: skip
    graph = quote(f"{BASE}data/zq7x9/graph", safe="")
    await do("PUT", f"/graphs?graph={graph}", 201, "<#x> <http://e.x/p> 'zq7x9stored' .", TURTLE)
    held = [await do("POST", f"/topics/{name}?rate=1&lease=5", 201, twist) for name in ("cmd_vel", "zq7x9_cmd")]
    await do("POST", "/bags/", 201, {"name": "done", "topics": ["*"], "before": 60})
    await do("POST", "/bags/", 201, {"name": "open", "topics": ["/open"], "before": 60})
    for name in ("open", "zq7x9_speed"):
        robot.publishes(f"/{name}", {"data": NUMBER if "zq7x9" in name else 4.5})
    for name in ("done", "open"):
        await do("PATCH", f"/bags/{name}/", 200, {"status": "ended"}, "application/merge-patch+json")
    sent = await do("GET", "/bags/done/file", 200)
    assert b"zq7x9_speed" in _inflated(sent.body)
    await do("PUT", "/bags/sent", 201, sent.body, "application/octet-stream")
    await do("POST", "/bags/", 201, {"name": "running", "topics": ["/zq7x9_speed", "/open", "/zq7x9_w*", "/shared"]})
    trigger: dict[str, object] = {"resource": "/topics/zq7x9_speed", "condition": "data > 73172511"}
    await do("POST", "/bags/", 201, {"name": "armed", "topics": ["/zq7x9_speed", "/open"], "trigger": trigger})
    trigger = {"condition": f"{BASE}mappings/zq7x9_car#low"}
    await do("POST", "/bags/", 201, {"name": "mapped", "topics": ["/open"], "trigger": trigger})
    wish = {
        "@context": ["https://www.w3.org/ns/solid/notifications-context/v1"],
        "type": "http://www.w3.org/ns/solid/notifications#StreamingHTTPChannel2023",
        "topic": f"{BASE}topics/zq7x9_speed",
    }
    await do("POST", "/channels/StreamingHTTPChannel2023", 201, wish, "application/ld+json")
    return [each.headers["location"].removeprefix(BASE[:-1]) for each in held]


@contextlib.asynccontextmanager
async def secretive_app(
    folder: Path, rules: str = RULES, agents: Sequence[str] = ("admin", "reader", "writer")
) -> AsyncIterator[tuple[Application, Secretive]]:
    """The robot with these rules, and everything that an administrator created on it."""
    robot = Secretive()
    robot.topic("/zq7x9_asked", "std_msgs/msg/Float64", {"data": NUMBER})
    file = folder / "auth.toml"
    file.write_text(tokens(*agents) + rules)
    chosen = Settings(
        base_url=BASE, auth=file, data=folder / "data", history=("*",), subscribe=("*",), max_publish_rate=1e9,
        client_rate=1e9, client_streams=1000, receipt_excerpt=200, versions=5, first_value_wait=0.1,
    )  # fmt: skip
    app = create_app(robot, chosen)
    async with lifespan(app):
        admin = Client(app, "admin")
        held = await fill(admin, robot)
        streams = [admin.begin("GET", f"{path}?keep=true", Accept="text/event-stream") for path in held]
        try:
            yield app, robot
        finally:
            await asyncio.gather(*(each.leave() for each in streams))


# The crawl


class Crawl:
    """A crawl of one agent along all links, in all syntaxes; `leaks` are the requests that revealed denied data."""

    def __init__(self, app: Application, agent: str) -> None:
        self.ask = Client(app, agent)
        self.seen: dict[str, int] = {}
        self.leaks: dict[str, set[str]] = {}
        self.failures: list[str] = []
        self._waiting: dict[str, None] = {}
        self.in_full: set[str] = set()
        self._alike: Counter[tuple[object, ...]] = Counter()

    async def walk(self, paths: Iterable[str]) -> None:
        """Read these paths, and everything that they lead to."""
        self.add(paths)
        while self._waiting:
            path = next(iter(self._waiting))
            del self._waiting[path]
            await self._look(path)

    async def walk_again(self, paths: Iterable[str]) -> None:
        """Read paths that may have been read before, and everything else that they lead to."""
        for path in paths:
            self.in_full.add(path)
            self.seen.pop(path, None)
            await self.walk([path])

    def add(self, paths: Iterable[str]) -> None:
        """Add paths to be read once."""
        self._waiting.update(dict.fromkeys(each for each in paths if each not in self.seen and "{" not in each))

    async def find_paths(self, paths: Iterable[str]) -> None:
        """Follow the links of these paths, reading each once."""
        self.add(paths)
        while self._waiting:
            path = next(iter(self._waiting))
            del self._waiting[path]
            answer = await self.ask("GET", path, Accept="application/n-triples")
            self.seen[path] = answer.status
            self._follow(answer)

    async def request(self, method: str, path: str, body: bytes = b"", **headers: str) -> Answer:
        """Return the response to a request, repeated while the dataset is behind. All responses are searched."""
        for _ in range(30):
            answer = await self.ask(method, path, body, **headers)
            if leaks := answer.leaks:
                self.leaks[f"{answer.request} {' '.join(headers.values())} {answer.status}"] = leaks
            if answer.status != 503 or b"being loaded into the dataset" not in answer.body:
                break
            await asyncio.sleep(float(answer.headers["retry-after"]))
        if answer.status >= 500:
            self.failures.append(f"{answer.request} {headers}: {answer.status} {answer.body!r:.500}")
        return answer

    async def _look(self, path: str) -> None:
        first = await self.request("GET", path, Accept="application/n-triples")
        self.seen[path] = first.status
        self._follow(first)
        joined = "&" if "?" in path else "?"
        names = re.findall(r"[?&](\w+)", path)
        kind = (path.split("/")[1], first.status, *names, *sorted(set(_CLASSES.findall(first.text))))
        self._alike[kind] += 1
        alike = 0 if path in self.in_full else self._alike[kind]
        if alike > AS_PAGES:
            return
        await self.request("GET", path, Accept="text/html")
        await self.request("OPTIONS", path)
        if first.status in (401, 404) or alike > IN_FULL:
            return
        await self.request("HEAD", path)
        for syntax in SYNTAXES:
            self._follow(await self.request("GET", path, Accept=syntax))
        await self.request("GET", path, Accept="text/event-stream")
        for variant in VARIANTS:
            await self.request("GET", f"{path}{joined}{variant}")
        for method, body, kind in WRITES:
            await self.request(method, path, body, Content_Type=kind)

    def _follow(self, answer: Answer) -> None:
        """Add the links of a response."""
        if answer.status >= 500 or "svg" in answer.headers.get("content-type", ""):
            return
        kind, text = answer.headers.get("content-type", ""), answer.text
        found = re.findall(r"<http://127\.0\.0\.1:8080(/[^>]*)>", text)
        if "html" in kind:
            found += [html.unescape(each) for each in re.findall(r'(?:href|src|action)="(/[^"]*)"', text)]
        elif "json" in kind:
            found += re.findall(r'"http://127\.0\.0\.1:8080(/[^"]*)"', text)
        self.add(each.partition("#")[0] for each in found if not _LEFT_OUT.search(each))


_CLASSES = re.compile(r"#type> <([^>]*)>")
_LEFT_OUT = re.compile(
    r"[?&](receipt|after|from|start|limit|add|part)=|[?&]offer$|/ontology/|messages/[0-9]*[3-9]$|/types/.*/.*/|/shapes/.*/.*/|\.(js|css|svg)$"
)
"""Paths that differ only in numbers from paths already read, and those that are the same on every server."""


async def ask_the_dataset(crawl: Crawl, urls: Iterable[str], results: Sequence[str] = RESULTS) -> None:
    """Run queries about everything, the stored ones, and those of the graphs at these URLs."""
    for text in QUERIES:
        for accept in results:
            await crawl.request(
                "POST", "/sparql", text.encode(), Content_Type="application/sparql-query", Accept=accept
            )
    listed = await crawl.request("GET", "/queries/", Accept="application/n-triples")
    for name in re.findall(r"/queries/([\w-]+)>", listed.text):
        for accept in ("application/json", "text/csv", "text/html", "application/n-triples"):
            await crawl.request("GET", f"/queries/{name}?run=true", Accept=accept)
    for url in urls:
        graph = quote(BASE[:-1] + url, safe="")
        await crawl.request("GET", f"/graphs?graph={graph}", Accept="text/turtle")
        text = f"SELECT * {{ GRAPH <{BASE[:-1]}{url}> {{ ?s ?p ?o }} }}"
        await crawl.request(
            "POST", "/sparql", text.encode(), Content_Type="application/sparql-query", Accept="text/csv"
        )


@pytest.mark.slow
def test_what_is_denied_is_told_nowhere(tmp_path: Path) -> None:
    asyncio.run(_look_everywhere(tmp_path))


async def _look_everywhere(folder: Path) -> None:
    async with secretive_app(folder) as (app, _):
        samples = SAMPLES | {name: (f"/{name}",) for name in FILES}
        assert samples.keys() == app.rooms, "every route has paths at which the crawl begins"
        paths = [path for each in samples.values() for path in each]
        everything = Crawl(app, "admin")
        await everything.find_paths(paths)
        crawl = Crawl(app, "reader")
        crawl.in_full.update(paths)
        await crawl.walk([*paths, *everything.seen])
        await ask_the_dataset(crawl, [path for path, status in everything.seen.items() if status == 200])
        await check_what_may_be_read(crawl.ask, everything.ask)
        await follow_streams(crawl, Client(app, "admin"))
        await wait_for_space(crawl, Client(app, "admin"))
        await crawl.walk_again(await stop(Client(app, "admin")))
        await subscribe_to_denied(crawl)
        print(f"{len(crawl.seen)} URLs, {crawl.ask.statuses.total()} answers: {dict(crawl.ask.statuses)}")
        assert not crawl.leaks
        assert not crawl.failures


async def follow_streams(crawl: Crawl, admin: Client) -> None:
    """Follow streams while an administrator writes to denied resources, and finally to others."""
    listened = ("/activity/", "/calls/", "/goals/", "/holds/", "/bags/", "/topics/", "/diagnostics", "/stop")
    streams = [
        crawl.ask.begin("GET", f"{path}?format={format}", Accept="text/event-stream")
        for path in listened
        for format in ("json", "ttl", "html")
    ]
    for each in streams:
        await each.hear(b"data:", seconds=1.0)
    before = [each.answer.body.count(b"data:") for each in streams]
    for name in ("zq7x9", "open"):
        await admin("POST", f"/services/{name}_service", b"{}", Content_Type=JSON)
        await admin("POST", f"/actions/{name}_action", b'{"angle": 2.0}', Content_Type=JSON)
        await admin("PUT", f"/topics/{name}_words", f'{{"data": "{name}streamed"}}'.encode(), Content_Type=JSON)
    for path, each, count in zip((path for path in listened for _ in range(3)), streams, before, strict=True):
        await each.hear(b"data:", count + 1, seconds=5.0 if path in ("/activity/", "/calls/", "/goals/") else 0.05)
        answer = await each.hang_up()
        if answer.leaks:
            crawl.leaks[f"stream of {path}"] = answer.leaks


async def wait_for_space(crawl: Crawl, admin: Client) -> None:
    """Wait for a second topic in space as a reader, who sees one, and as an administrator, who sees two."""
    waits = [
        (client, client.begin("GET", f"/space?until={quote(condition)}", Accept=JSON))
        for client, condition in ((admin, "frame = 'never'"), (crawl.ask, "show[1].kind != 'never'"))
    ]
    for client, each in waits:
        await client("GET", "/space")  # as long as the wait takes to begin
        assert not each.answer.leaks
    for _, each in waits:
        answer = await each.hang_up()
        assert (answer.status, answer.body) == (204, b"")


async def subscribe_to_denied(crawl: Crawl) -> None:
    """Request channels about denied resources, and about resources that do not exist."""
    for path in ("/plot?y=topics/{}%23data", "/space?show=topics/{}", "/diagnostics?name={}"):
        answers = set()
        for name in ("zq7x9_scan", "zq7x9_speed", "zq7x9 motor", "zq7x9_never"):
            topic = BASE[:-1] + path.format(quote(name))
            wish = {
                "@context": ["https://www.w3.org/ns/solid/notifications-context/v1"],
                "type": "http://www.w3.org/ns/solid/notifications#StreamingHTTPChannel2023",
                "topic": topic,
            }
            answer = await crawl.ask("POST", "/channels/StreamingHTTPChannel2023", json.dumps(wish).encode(),
                                     Content_Type="application/ld+json")  # fmt: skip
            answers.add((answer.status, answer.body.replace(topic.encode(), b"")))
        assert [status for status, _ in answers] == [422], path


async def stop(admin: Client) -> list[str]:
    """Stop the robot, which affects denied resources; return the paths that mention them."""
    answer = await admin("POST", "/stop", b'{"reason": "a test"}', Content_Type=JSON)
    assert answer.status in (200, 201), answer.body
    return ["/", "/stop", "/holds/", "/activity/", "/topics/", "/topics/cmd_vel", "/resources/car/", "/cockpit/default"]


async def check_what_may_be_read(reader: Client, admin: Client) -> None:
    """Check that permitted resources are still readable, and that the administrator sees what the reader does not."""
    assert (await reader("GET", "/bags/open/file")).status == 200
    refused = await reader("GET", "/bags/done/file")
    assert refused.status == 403
    assert b"it also describes resources that you may not read" in refused.body
    assert (await reader("GET", "/bags/done/file", Range="bytes=0-10")).status == 403
    for path in ("/calls/", "/goals/", "/holds/", "/activity/"):
        mine, all = [
            (await ask("GET", path, Accept=JSON)).body.count(b"8080" + path.encode()) for ask in (reader, admin)
        ]
        assert 1 < mine < all, path
    moments = [json.loads((await ask("GET", "/bags/done/at", Accept=JSON)).body) for ask in (reader, admin)]
    told, there = ({each["topic"] for each in moment["messages"]} for moment in moments)
    assert told == {each for each in there if "zq7x9" not in each}
    for path in ("/bags/done/at", "/bags/done/file", "/bags/armed/", "/cockpit/default", "/cockpit/kept", "/calls/"):
        assert (await admin("GET", path)).leaks, path


# Writes

INSERT = "INSERT DATA {{ GRAPH <{0}> {{ <{0}> <http://www.w3.org/1999/02/22-rdf-syntax-ns#value> 3 }} }}"
UPDATE, MERGE = "application/sparql-update", "application/merge-patch+json"
TAKEN = """
<#car> a map:ComplexResource ; map:path "/car/" ; map:property [ map:predicate ex:open ; map:member "/open" ] .
"""
NEAR = TAKEN.replace("/car/", "/cart/").replace("/open", "/zq7x9_spee")
REFUSED = (
    ("PUT", "/topics/shared", '{"data": 1}', JSON),
    ("POST", "/sparql", INSERT.format("/topics/shared"), UPDATE),
    ("POST", "/sparql", INSERT.format("/resources/grip"), UPDATE),
    ("PUT", "/graphs?graph=/topics/shared", "<#x> <http://e.x/p> 1 .", TURTLE),
    ("PUT", "/resources/grip", "3", JSON),
    ("PATCH", "/resources/grip", "3", MERGE),
    ("POST", "/resources/car/act", "{}", JSON),
    ("POST", "/resources/car/turn", "{}", JSON),
    ("PATCH", "/resources/car/", '{"nothing": 3}', MERGE),
    ("PUT", "/parameters/open/limited", "99", JSON),
    ("PUT", "/mappings/taken", PREFIXES + TAKEN, TURTLE),
    ("PUT", "/mappings/near", PREFIXES + NEAR, TURTLE),
    ("POST", "/bags/", '{"topics": ["*"], "trigger": {"resource": "/resources/grip", "condition": "x > 1"}}', JSON),
)
"""Writes that are refused, or answered with a warning, because of a denied resource."""


async def described_writes(ask: Client) -> list[tuple[str, str, Set[str]]]:
    """Return the method, path and media types of each write in an agent's description, deletions last."""
    described = json.loads((await ask("GET", "/openapi.json")).body)

    def resolved(item: dict[str, Any]) -> dict[str, Any]:
        *_, part, name = item.get("$ref", "//").split("/")
        return described["components"][part][name] if name else item

    return [
        (
            method.upper(),
            re.sub(r"\{\w+\}", "made", path),
            resolved(written.get("requestBody", {})).get("content", {}).keys(),
        )
        for method in ("put", "post", "patch", "delete")
        for path, item in described["paths"].items()
        if (written := resolved(item).get(method)) is not None
    ]


async def bodies_for(ask: Client, path: str, kinds: Set[str]) -> list[tuple[str, bytes]]:
    """Return bodies of these media types for a path, some valid and some not, each with its type."""
    there = await ask("GET", path, Accept=JSON)
    texts = [there.body if there.status == 200 else b"{}", b'{"data": 1, "strange": "x"}', b"{nonsense"]
    found = [(kind, text) for kind in (JSON, MERGE) for text in texts]
    found += [(TURTLE, b"<> <http://e.x/p> 1 ."), (UPDATE, b"INSERT DATA { <> <http://e.x/p> 1 }")]
    return [(kind, text) for kind, text in found if kind in kinds] or [("", b"")]


@pytest.mark.slow
def test_no_answer_to_a_write_tells_what_is_denied(tmp_path: Path) -> None:
    asyncio.run(_write_everywhere(tmp_path))


async def _write_everywhere(folder: Path) -> None:
    async with secretive_app(folder) as (app, _):
        crawl = Crawl(app, "writer")
        writes = await described_writes(crawl.ask)
        known = {("PUT", "/resources/grip"), ("PUT", "/topics/open_words"), ("DELETE", "/data/made")}
        assert known <= {(method, path) for method, path, _ in writes}
        for is_dry in (True, False):
            for method, path, body, kind in REFUSED:
                query = ("&" if "?" in path else "?") + f"dry-run={is_dry}".lower()
                for accept in (JSON, TURTLE, "text/html"):
                    await crawl.request(method, path + query, body.encode(), Content_Type=kind, Accept=accept)
            for path in ("/resources/grip", "/resources/grip?at=-0.01", "/resources/?at=-0.01"):
                for accept in (JSON, TURTLE, "text/html"):
                    await crawl.request("GET", path, Accept=accept)
            for method, path, kinds in writes:
                for kind, data in await bodies_for(crawl.ask, path, kinds):
                    sent = {"Content_Type": kind} if kind else {}
                    sent |= {"If_Match": "*"} if method == "PATCH" else {}
                    await crawl.request(method, f"{path}?dry-run={is_dry}".lower(), data, **sent)
        page = (await crawl.ask("GET", "/resources/grip", Accept="text/html")).text
        (token,) = re.findall(r'name="csrf" value="([^"]*)">\n<input type="hidden" name="method" value="PUT"', page)
        form = f"csrf={token}&method=PUT&value=3".encode()
        await crawl.request("POST", "/resources/grip", form, Content_Type="application/x-www-form-urlencoded")
        print(f"{len(writes)} writes, {crawl.ask.statuses.total()} answers: {dict(crawl.ask.statuses)}")
        assert {200, 201, 204, 400, 403, 405, 409, 422} <= crawl.ask.statuses.keys()
        assert not crawl.leaks
        assert not crawl.failures
