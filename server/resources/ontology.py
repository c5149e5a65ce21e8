"""The ontology: `/ontology` is its core, `/ontology/NAME` another module, `/ontology/VERSION/NAME` a version of one."""

from __future__ import annotations

from collections.abc import Sequence

from rosld.ontology.document import Document
from rosld.ontology.modules import CORE, MODULES, VERSION, module_url, served_triples
from rosld.ontology.urls import Location
from rosld.server.http.problem import Problem
from rosld.server.hypermedia.message_schemas import MessageSchemas
from rosld.server.resources.context import Robot
from rosld.server.rest.path_item import PathItem
from rosld.server.rest.resource import Resource, permanent_redirect
from rosld.server.rest.state import State


class OntologyResource(Resource):
    """A module of the ontology, as it is now or as one version of it."""

    kind = "Ontology"

    def __init__(self, robot: Robot, name: str = CORE, version: str = "") -> None:
        super().__init__(module_url(name, robot.space.base, version))
        self.title = "Ontology" if name == CORE else f"Ontology: {name}"
        self.robot = robot
        self.name = name

    def path_item(self, schemas: MessageSchemas) -> PathItem:
        return PathItem("The core of the ontology" if self.name == CORE else f"A module of the ontology: {self.name}")

    @property
    def conforms_to(self) -> Sequence[str]:
        return (self.robot.space.document_shape("Ontology"),)

    async def state(self) -> State:
        return self.robot.states.get_or_make(self.url, 0, lambda: State(self.document))

    def document(self) -> Document:
        """The module; it says nothing of its URL here, so that it is the same ontology everywhere."""
        return Document(self.url, served_triples(self.name))


def ontology_room(robot: Robot, location: Location) -> Resource:
    """`/ontology` and below."""
    if location.is_container:
        raise permanent_redirect(robot.space.url("ontology", location.segments))
    version = location.segments[0] if location.segments[:1] == (VERSION,) else ""
    rest = location.segments[1:] if version else location.segments
    if rest == (CORE,):
        raise permanent_redirect(module_url(CORE, robot.space.base, version))
    if not rest:
        return OntologyResource(robot, CORE, version)
    if len(rest) == 1 and rest[0] in MODULES:
        return OntologyResource(robot, rest[0], version)
    raise Problem(
        404,
        f"The ontology has no {'/'.join(location.segments)}: its version is {VERSION}, its modules are "
        f"{', '.join(MODULES)}.",
    )
