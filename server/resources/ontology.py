"""The ontology: `/ontology` is its core, `/ontology/NAME` another module, `/ontology/VERSION/NAME` a version of one."""

from __future__ import annotations

from collections.abc import Sequence

from rosld.ontology.document import Document
from rosld.ontology.modules import CORE, MODULES, VERSION, module_url, served_triples
from rosld.ontology.urls import Location, Space
from rosld.server.http.problem import Problem
from rosld.server.hypermedia.json_schema import MessageSchemas
from rosld.server.rest.path_item import PathItem
from rosld.server.rest.resource import Resource, permanent_redirect
from rosld.server.rest.state import State
from rosld.server.runtime.version_cache import VersionCache


class OntologyResource(Resource):
    """A module of the ontology, as it is now or as one version of it."""

    kind = "Ontology"

    def __init__(self, space: Space, states: VersionCache[State], name: str = CORE, version: str = "") -> None:
        super().__init__(module_url(name, space.base, version))
        self.title = "Ontology" if name == CORE else f"Ontology: {name}"
        self.space = space
        self.states = states
        self.name = name

    def path_item(self, schemas: MessageSchemas) -> PathItem:
        return PathItem("The core of the ontology" if self.name == CORE else f"A module of the ontology: {self.name}")

    @property
    def conforms_to(self) -> Sequence[str]:
        return (self.space.document_shape("Ontology"),)

    async def state(self) -> State:
        return self.states.get_or_make(self.url, 0, lambda: State(self.document))

    def document(self) -> Document:
        """Return the module; it says nothing of its URL here, so that it is the same ontology everywhere."""
        return Document(self.url, served_triples(self.name))


def ontology_route(space: Space, states: VersionCache[State], location: Location) -> Resource:
    """Return the module of the vocabulary at `/ontology` or below. Raises a 404 Problem where there is none."""
    if location.is_container:
        raise permanent_redirect(space.url("ontology", location.segments))
    version = location.segments[0] if location.segments[:1] == (VERSION,) else ""
    rest = location.segments[1:] if version else location.segments
    if rest == (CORE,):
        raise permanent_redirect(module_url(CORE, space.base, version))
    if not rest:
        return OntologyResource(space, states, CORE, version)
    if len(rest) == 1 and rest[0] in MODULES:
        return OntologyResource(space, states, rest[0], version)
    raise Problem(
        404,
        f"The ontology has no {'/'.join(location.segments)}: its version is {VERSION}, its modules are "
        f"{', '.join(MODULES)}.",
    )
