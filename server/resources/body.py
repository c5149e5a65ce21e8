"""The body of the robot at `/body`: the links, joints and sensors of its `robot_description`."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from rosld.adapters.base import Watch
from rosld.ontology.describe_body import NAME, Source, body_document, body_sources
from rosld.server.auth.errors import not_found
from rosld.server.http.conditional import digest
from rosld.server.http.problem import Problem
from rosld.server.resources.base import SessionResource
from rosld.server.resources.messages import decode
from rosld.server.rest.exchange import Exchange
from rosld.server.rest.path_item import PathItem
from rosld.server.rest.resource import RDF_SOURCE, RESOURCE, Resource
from rosld.server.rest.state import State
from rosld.server.runtime.tasks import combine_watches, loop_time

_LONG = 64 * 1024
"""Minimum number of characters of descriptions that are read in a thread: some 10 ms."""


class BodyResource(SessionResource):
    """The body of the robot, visible to agents who may read all of its descriptions."""

    kind = "Body"
    shape = "Body"
    title = "Body"
    path = "body"
    item = PathItem("The links, joints and sensors of the robot, from its description (URDF)")
    links = (RESOURCE, RDF_SOURCE)
    is_found_by_state = True

    async def select_variant(self, exchange: Exchange) -> Resource:
        if not all(exchange.permissions.may_read(each.url(self.space)) for each in body_sources(self.session.graph)):
            raise not_found()
        return self

    async def watch(self, wake: Callable[[], None]) -> Watch | None:
        topics = [each.name for each in body_sources(self.session.graph) if each.route == "topics"]
        return combine_watches(*[await self.session.topics.watch(each, wake) for each in topics]) if topics else None

    async def state(self) -> State:
        sources = body_sources(self.session.graph)
        if not sources:
            raise Problem(404, f"The robot has no topic and no parameter {NAME}, from which its body would be read.")
        texts = [(each, *await self._read(each)) for each in sources]
        token = digest(repr(texts).encode("utf-8", "surrogatepass"))
        size = sum(len(text) for _, text, _ in texts)
        describe = partial(body_document, self.url, texts, self.space)
        return self.states.get_or_make(
            self.url, token, lambda: State(describe, token=token, weight=size, is_long=size > _LONG)
        )

    async def _read(self, source: Source) -> tuple[str, str]:
        """Return the text of a source, and why there is none."""
        if source.route == "parameters":
            deadline = loop_time() + self.session.settings.call_deadline
            value = (await self.session.adapter.get_parameters([source.name], deadline=deadline)).get(source.name)
            return (value, "") if isinstance(value, str) else ("", "It is not a string")
        newest = (await self.session.topics.read(source.name)).newest
        if newest is None:
            return "", "No message has arrived yet"
        decoded = await decode(self.session.schemas, newest)
        if decoded.message is None:
            return "", f"The message cannot be read: {decoded.reason}"
        return str(getattr(decoded.message, "data", "")), ""
