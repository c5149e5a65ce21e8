"""The computation graph at `/graph`: drawn (SVG, DOT), and its edges in RDF and JSON."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from urllib.parse import quote

import orjson
from starlette.responses import Response

from rosld.adapters.base import Watch
from rosld.adapters.model import Graph, Topic
from rosld.ontology.describe_graph import edges_document, node_views
from rosld.ontology.document import Document
from rosld.ontology.literals import date_time
from rosld.server.diagrams import svg
from rosld.server.diagrams.diagram import Diagram, Selection, Traffic, draw_graph, fold, namespaces_of
from rosld.server.html.forms import Form
from rosld.server.html.page import Csrf, GraphPage, Notice
from rosld.server.html.render import render_graph
from rosld.server.html.site import Site
from rosld.server.http.conditional import ETag, digest
from rosld.server.http.problem import Problem
from rosld.server.hypermedia.json_schema import BOOLEAN, NUMBER, TEXT, URI, JsonSchema, json_array, json_object
from rosld.server.resources.base import SessionResource
from rosld.server.resources.namespaces import listed_graph
from rosld.server.rest.exchange import Exchange
from rosld.server.rest.formats import FORMATS, OFFERS
from rosld.server.rest.path_item import PathItem, QueryParameter
from rosld.server.rest.resource import RDF_SOURCE, RESOURCE, Resource
from rosld.server.rest.responses import bytes_response, resource_headers
from rosld.server.rest.state import State
from rosld.server.robot.diagnostic_states import STALE_SECONDS
from rosld.server.robot.topic_view import EMPTY_VIEW, TopicView
from rosld.server.robot.velocity import OCCASIONAL_TYPES
from rosld.server.runtime.tasks import call_every

_DRAWINGS = {"svg": svg.MEDIA_TYPE, "dot": svg.DOT_TYPE}
_MAX_NAME = 300
_MAX_PROBLEMS = 200
_LOOK_SECONDS = 2.0
_STEADY = 10
"""Messages of a publisher from which on it can fall silent: fewer are single events."""
_POLICY = "default-src 'none'; style-src 'unsafe-inline'; frame-ancestors 'none'"
"""Of a drawing by itself: its own style, and nothing else."""
_PARAMETERS = (
    QueryParameter("below", "A name: draw only what is below it and its connections."),
    QueryParameter("all", "Whether to draw topics and services that every node has, too.", {"type": "boolean"}),
    QueryParameter(
        "format", "The requested representation; overrides Accept.", {"type": "string", "enum": [*FORMATS, *_DRAWINGS]}
    ),
)
_PLAIN: JsonSchema = json_object(
    {
        "vertices": json_array(
            json_object(
                {"name": TEXT, "kind": {"type": "string", "enum": ["node", "topic", "service", "action"]}, "url": URI},
                {"rate": NUMBER, "problem": TEXT, "unheard": BOOLEAN},
            )
        ),
        "edges": json_array(json_object({"source": URI, "target": URI}, {"problem": TEXT})),
    }
)


class GraphResource(SessionResource):
    """A drawing of the computation graph or a part of it, with the permissions of one agent."""

    kind = "Computation graph"
    shape = "Source"
    title = "Graph"
    path = "graph"
    item = PathItem("Who talks to whom", (*OFFERS, *_DRAWINGS.values()), plain=_PLAIN, query=_PARAMETERS)
    links = (RESOURCE, RDF_SOURCE)

    _selection = Selection()

    async def select_variant(self, exchange: Exchange) -> Resource:
        """Return the part selected by the query, with the agent's permissions. Raises a 400 Problem."""
        below = exchange.query.get("below", "")
        if below and (not below.startswith("/") or len(below) > _MAX_NAME):
            raise Problem(400, f"?below={below[:40]} must be a name of the robot, such as /camera.")
        everything = exchange.query_flag("all")
        pairs = {"below": quote(below, safe="/"), "all": "true" if everything else ""}
        query = "&".join(f"{name}={value}" for name, value in pairs.items() if value)
        url = f"{self.url}?{query}" if query else self.url
        return self.variant(url=url, _selection=Selection(below, everything), _permissions=exchange.permissions)

    async def watch(self, wake: Callable[[], None]) -> Watch | None:
        """Return a watch of the graph; rates change all the time, and are polled."""
        return call_every(_LOOK_SECONDS, wake)

    async def state(self) -> State:
        graph = self._graph()
        diagram = self._diagram(graph)
        plain = _plain(diagram)
        return State(lambda: self._describe(graph, diagram), lambda: plain, digest(plain))

    def document(self) -> Document:
        """Return the current edges and their problems."""
        graph = self._graph()
        return self._describe(graph, self._diagram(graph))

    def _describe(self, graph: Graph, diagram: Diagram) -> Document:
        views, urls = node_views(graph), frozenset(each.url for each in diagram.vertices)
        problems = [(each.url, words) for each, words in diagram.problems]
        return edges_document(self.url, views, self.space, urls, problems)

    def _graph(self) -> Graph:
        """Return the current graph as listed."""
        return listed_graph(self.session.graph, self.session.adapter.capabilities)

    def _diagram(self, graph: Graph) -> Diagram:
        return draw_graph(graph, self.space, self._selection, self._traffic, self._permissions.may_read)

    def _traffic(self, topic: Topic) -> Traffic:
        """Return the observations of a topic, without subscribing; the rate has two digits to change rarely."""
        session, view = self.session, self.session.topics.peek(topic.name) or EMPTY_VIEW
        silence = "" if any(each.name in OCCASIONAL_TYPES for each in topic.types) else self._silence(view)
        return Traffic(
            0.0 if silence or view.rate is None else float(f"{view.rate:.2g}"),
            silence,
            topic.name in session.adapter.published,
            session.adapter.subscriptions[topic.name] > 0,
        )

    def _silence(self, view: TopicView) -> str:
        """Since when nothing comes, where messages came at least once a second."""
        newest = view.newest
        if newest is None or view.rate is None or view.rate < 1.0 or newest.sequence < _STEADY:
            return ""
        if self.session.adapter.age_ns(newest) < STALE_SECONDS * 1e9:
            return ""
        since = date_time(0, newest.received_ns)
        return f"went silent: no message since {since}, {view.rate:.2g} per second before"

    async def custom_get(self, exchange: Exchange) -> Response | None:
        """Return the drawing as SVG (folded if large) or DOT (whole) if preferred."""
        media_type = exchange.preferred(_DRAWINGS, (*OFFERS, *_DRAWINGS.values()))
        if media_type not in _DRAWINGS.values():
            return None
        diagram = self._diagram(self._graph())
        headers = {**resource_headers(self), "x-content-type-options": "nosniff"}
        if media_type == svg.MEDIA_TYPE:
            headers["content-security-policy"] = _POLICY
            text = self._svg(fold(diagram, f"{self.space.base}graph"), Site(self.space.base, "").href, alone=True)
        else:
            text = svg.write_dot(diagram)
        data, name = text.encode("utf-8", "replace"), "svg" if media_type == svg.MEDIA_TYPE else "dot"
        etag = ETag(f"{self.services.instance_id}-{digest(data)}", name)
        return bytes_response(exchange, data, f"{media_type}; charset=utf-8", etag, headers.items())

    def _svg(self, diagram: Diagram, href: Callable[[str], str | None], *, alone: bool) -> str:
        return svg.write_svg(diagram, href, f"The computation graph of {self.session.name}", alone=alone)

    def page(self, site: Site, state: State, forms: Sequence[Form], csrf: Csrf, notices: Sequence[Notice]) -> bytes:
        diagram = self._diagram(self._graph())
        folded = fold(diagram, f"{self.space.base}graph")
        problems = [(each.url, words) for each, words in diagram.problems[:_MAX_PROBLEMS]]
        return render_graph(
            GraphPage(
                site,
                self.url,
                self._svg(folded, site.href, alone=False) if folded.vertices else "",
                len(folded.vertices),
                diagram.total,
                self._selection.below,
                self._selection.everything,
                namespaces_of(diagram),
                tuple(problems),
                tuple(notices),
            )
        )


def _plain(diagram: Diagram) -> bytes:
    urls = {each.key: each.url for each in diagram.vertices}
    vertices = [
        {"name": each.name, "kind": each.kind.value, "url": each.url}
        | ({"rate": each.rate} if each.rate else {})
        | ({"problem": each.problem} if each.problem else {})
        | ({"unheard": True} if each.is_unheard else {})
        for each in diagram.vertices
    ]
    edges = [
        {"source": urls[each.source], "target": urls[each.target]} | ({"problem": each.problem} if each.problem else {})
        for each in diagram.edges
    ]
    return orjson.dumps({"vertices": vertices, "edges": edges})
