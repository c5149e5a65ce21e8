"""Plots: `/plot?y=topics/odom%23twist.twist.linear.x`, numbers of topics over time, drawn together."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import orjson
from starlette.responses import Response

from rosld.ontology.describe_views import PlottedNumber, plot_document
from rosld.ontology.document import Document
from rosld.server.auth.permissions import ALLOW_ALL, Permissions
from rosld.server.events.broadcaster import Broadcasters
from rosld.server.events.event_stream import HEADERS
from rosld.server.events.query_params import EVENT_STREAM, stream_is_preferred
from rosld.server.events.sample_stream import FollowedTopic, SampleStream
from rosld.server.history.history import History
from rosld.server.html.forms import Form
from rosld.server.html.graphics import plot_query
from rosld.server.html.page import Csrf, Notice, PlotPage
from rosld.server.html.render import render_plot
from rosld.server.html.site import Site
from rosld.server.http.conditional import digest
from rosld.server.http.problem import Problem
from rosld.server.hypermedia.affordance_service import AffordanceService
from rosld.server.hypermedia.data_schema import DataSchema
from rosld.server.hypermedia.json_schema import TEXT, URI
from rosld.server.hypermedia.message_schemas import MessageSchemas
from rosld.server.resources.number_finder import NumberFinder
from rosld.server.rest.exchange import Exchange
from rosld.server.rest.formats import OFFERS
from rosld.server.rest.path_item import FORMAT, PathItem, QueryParameter
from rosld.server.rest.resource import RDF_SOURCE, RESOURCE, Resource
from rosld.server.rest.responses import RawResponse
from rosld.server.rest.state import State
from rosld.server.robot.session import Session

MAX_NUMBERS = 16
"""Numbers of one plot."""
_PARAMETERS = (
    QueryParameter(
        "y",
        "A number of a topic or of a property: its URL, or that below the base, and after # the path of the field. "
        "It may be given several times.",
        {"type": "array", "items": TEXT},
    ),
    FORMAT,
)
_PLAIN: DataSchema = {
    "type": "object",
    "properties": {
        "y": {
            "type": "array",
            "items": {
                "type": "object",
                "properties": {"topic": URI, "field": TEXT, "type": TEXT, "series": {"type": ["string", "null"]}},
                "required": ["topic", "field", "type", "series"],
            },
        },
    },
    "required": ["y"],
}


class PlotResource(Resource):
    """The plot of some numbers; without any, what can be asked for."""

    kind = "Plot"
    links = (RESOURCE, RDF_SOURCE)
    is_cacheable = False

    def __init__(
        self,
        session: Session,
        affordances: AffordanceService[State],
        history: History,
        broadcasters: Broadcasters,
        references: Sequence[str] = (),
        permissions: Permissions = ALLOW_ALL,
    ) -> None:
        self.references = tuple(references)
        super().__init__(f"{session.space.base}plot{plot_query(references)}")
        self.session = session
        self.affordances = affordances
        self.history = history
        self._broadcasters = broadcasters
        self._permissions = permissions
        self._numbers: Sequence[PlottedNumber] = ()

    def path_item(self, schemas: MessageSchemas) -> PathItem:
        return PathItem(
            "A plot of numbers over time", (*OFFERS, EVENT_STREAM), _PLAIN, query=_PARAMETERS, streams=False
        )

    async def select_variant(self, exchange: Exchange) -> Resource:
        """The plot of what the `y` say, as far as the agent may see it. Raises Problems."""
        references = exchange.query_values("y")
        if len(references) > MAX_NUMBERS:
            raise Problem(
                400, f"?y= is there {len(references)} times: at most {MAX_NUMBERS} numbers are drawn together."
            )
        return PlotResource(
            self.session, self.affordances, self.history, self._broadcasters, references, exchange.permissions
        )

    @property
    def conforms_to(self) -> Sequence[str]:
        return (self.session.space.document_shape("Plot"),)

    def document(self) -> Document:
        """The plot while nothing is asked for."""
        return plot_document(self.url, ())

    async def state(self) -> State:
        finder = NumberFinder(self.session, self.affordances, self.history, self._permissions)
        numbers = self._numbers = [await finder.describe(await finder.locate(each)) for each in self.references]
        plain = orjson.dumps({"y": [number_json(each) for each in numbers]})
        return State(partial(plot_document, self.url, numbers), lambda: plain, digest(plain))

    async def custom_get(self, exchange: Exchange) -> Response | None:
        """The event stream of the numbers as they come, where one is preferred; else None.

        Raises a 400 Problem without numbers, 404 for one that there is not.
        """
        if not stream_is_preferred(exchange.accept, OFFERS):
            return None
        if not self.references:
            raise Problem(400, "?y= says which numbers are to be told, such as y=topics/odom%23twist.twist.linear.x.")
        finder = NumberFinder(self.session, self.affordances, self.history, self._permissions)
        fields: dict[str, list[tuple[int, str]]] = {}
        for place, reference in enumerate(self.references):
            number = await finder.locate(reference)
            await finder.describe(number)
            fields.setdefault(number.topic, []).append((place, number.field))
        if exchange.method == "HEAD":
            return RawResponse(200, b"", HEADERS)
        self._broadcasters.require_capacity(exchange.request.client)
        topics = [FollowedTopic(topic, tuple(each)) for topic, each in fields.items()]
        schema_of, is_valid = self.session.schemas.message, exchange.auth.is_valid
        return SampleStream(self._broadcasters, self.session.adapter, schema_of, topics, is_valid)

    def page(self, site: Site, state: State, forms: Sequence[Form], csrf: Csrf, notices: Sequence[Notice]) -> bytes:
        return render_plot(PlotPage(site, self.url, tuple(self._numbers), self.references, tuple(notices)))


def number_json(number: PlottedNumber) -> dict[str, str | None]:
    """A number as plain JSON."""
    return {"topic": number.topic, "field": number.field, "type": number.type, "series": number.series}
