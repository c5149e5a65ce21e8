"""The vocabularies, served where their terms are looked for."""

from __future__ import annotations

from functools import cache
from importlib.resources import files

from pyoxigraph import RdfFormat, Triple, parse

from rosld.ontology.document import Document
from rosld.server.hypermedia.message_schemas import MessageSchemas
from rosld.server.resources.context import Robot
from rosld.server.rest.path_item import PathItem
from rosld.server.rest.resource import Resource
from rosld.server.rest.state import State

FILES = ("rosld.ttl", "mapping.ttl", "aircraft.ttl", "align.ttl")
"""The vocabularies of rosld, and what aligns them with others."""


@cache
def vocabulary() -> tuple[Triple, ...]:
    """Every triple of the vocabularies and of their alignments."""
    folder = files("rosld.ontology")
    texts = [(folder / name).read_bytes() for name in FILES]
    return tuple(quad.triple for text in texts for quad in parse(text, format=RdfFormat.TURTLE))


class OntologyResource(Resource):
    """`/ontology`."""

    kind = "Vocabulary"

    def __init__(self, robot: Robot) -> None:
        super().__init__(f"{robot.space.base}ontology")
        self.robot = robot

    def path_item(self, schemas: MessageSchemas) -> PathItem:
        return PathItem("The vocabulary")

    async def state(self) -> State:
        return self.robot.states.get_or_make(self.url, 0, lambda: State(lambda: Document(self.url, vocabulary())))
