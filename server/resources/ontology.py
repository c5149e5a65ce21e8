"""The vocabulary, served where its terms are looked for."""

from __future__ import annotations

from functools import cache
from importlib.resources import files

from pyoxigraph import RdfFormat, Triple, parse

from rosld.ontology.document import Document
from rosld.server.ldp.resource import Resource
from rosld.server.ldp.state import State
from rosld.server.robot import Robot


@cache
def vocabulary() -> tuple[Triple, ...]:
    """Every triple of the vocabulary and of its alignments."""
    folder = files("rosld.ontology")
    texts = [(folder / name).read_bytes() for name in ("rosld.ttl", "align.ttl")]
    return tuple(quad.triple for text in texts for quad in parse(text, format=RdfFormat.TURTLE))


class OntologyResource(Resource):
    """`/ontology`."""

    kind = "Vocabulary"

    def __init__(self, robot: Robot) -> None:
        super().__init__(f"{robot.space.base}ontology")
        self.robot = robot

    async def state(self) -> State:
        return self.robot.states.get(self.url, 0, lambda: State(lambda: Document(self.url, vocabulary())))
