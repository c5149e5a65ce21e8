"""Numbers of topics by the references that plots name them by: a URL, and after # the path of a field."""

from __future__ import annotations

from typing import NamedTuple
from urllib.parse import quote

from rosld.adapters.model import Array, RosError, TypeRef
from rosld.ontology.describe_views import PlottedNumber
from rosld.ontology.fields import number_type
from rosld.server.auth.errors import not_found
from rosld.server.auth.permissions import Permissions
from rosld.server.history.history import History
from rosld.server.html.messages import type_name
from rosld.server.http.problem import Problem
from rosld.server.hypermedia.affordance_service import AffordanceService
from rosld.server.hypermedia.catalogue import TopicSource
from rosld.server.resources.memento import is_recorded
from rosld.server.rest.state import State
from rosld.server.robot.session import Session

_MAX_REFERENCE = 1000


class NumberReference(NamedTuple):
    """A number that is plotted: the topic's name, the path of the field."""

    topic: str
    field: str


class NumberFinder:
    """Finds the numbers of a robot that an agent may see."""

    def __init__(
        self, session: Session, affordances: AffordanceService[State], history: History, permissions: Permissions
    ) -> None:
        self._session = session
        self._affordances = affordances
        self._history = history
        self._permissions = permissions

    async def locate(self, reference: str) -> NumberReference:
        """The topic and the field that a `y` names. Raises Problems."""
        url, _, path = reference.partition("#")
        space = self._session.space
        if len(reference) > _MAX_REFERENCE:
            raise Problem(400, f"?y={reference[:60]}... is too long.")
        url = space.absolute(url)
        if not path and f"/{url}".find("/topics/") >= 0:
            raise Problem(400, f"?y={reference[:100]}: say which field, after # as %23, such as %23data.")
        location = None if "?" in url else space.location(url)
        if location is None or location.is_container or location.kind not in ("topics", "resources"):
            words = "names no topic and no property of this robot: send such as topics/odom#twist.twist.linear.x"
            raise Problem(400, f"?y={reference[:100]} {words}, with # as %23.")
        if not self._permissions.may_read(url):
            raise not_found()
        if location.kind == "resources":
            return await self._of_property(location.name, url, path)
        if location.name not in self._session.graph.topics:
            raise Problem(404, f"There is no topic {location.name}.")
        return NumberReference(location.name, path)

    async def _of_property(self, name: str, url: str, path: str) -> NumberReference:
        """The field of the topic that a property is read from."""
        plan = (await self._affordances.tree()).property(name)
        if plan is None:
            raise Problem(404, f"There is no property {name}.")
        source = next((each for each in plan.source.readers if isinstance(each, TopicSource)), None)
        if source is None or not self._permissions.may_read(self._session.space.topic(source.name)):
            raise Problem(422, f"{url} is not read from a topic: only what a robot tells by itself is drawn over time.")
        fields = [] if source.schema is None else source.schema.type.fields
        return NumberReference(source.name, path or (fields[0].name if len(fields) == 1 else ""))

    async def describe(self, number: NumberReference) -> PlottedNumber:
        """What a number is, and what is recorded of it. Raises Problems."""
        topic = self._session.graph.topics[number.topic]
        url = self._session.space.topic(number.topic)
        if topic.type is None:
            raise Problem(422, f"{number.topic} has publishers of several types.")
        try:
            schema = await self._session.schemas.message(TypeRef(topic.type.name, topic.type.hash))
            kind = number_type(schema, number.field)
        except ValueError as error:
            raise Problem(422, f"?y={number.topic}#{number.field[:60]}: {error}.") from error
        except RosError as error:
            raise Problem(422, f"The type of {number.topic} is not known: {error.sentence}") from error
        has_series = not isinstance(kind, Array) and is_recorded(self._history, number.topic)
        series = f"{url}?series={quote(number.field, safe='.')}" if has_series else None
        return PlottedNumber(url, number.field, type_name(kind), series)
