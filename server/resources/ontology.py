"""The ontology: `/ontology` is its core, `/ontology/NAME` another module."""

from __future__ import annotations

from rosld.ontology.document import Document
from rosld.ontology.modules import CORE, MODULES, module_url, served_triples
from rosld.ontology.urls import Location, Space
from rosld.server.http.problem import Problem
from rosld.server.rest.path_item import PathItem
from rosld.server.rest.resource import Resource, permanent_redirect
from rosld.server.rest.state import State
from rosld.server.runtime.version_cache import VersionCache


class OntologyResource(Resource):
    """A module of the ontology."""

    kind = "Ontology"
    shape = "Ontology"

    def __init__(self, space: Space, states: VersionCache[State], name: str = CORE) -> None:
        super().__init__(space, module_url(name, space.base))
        self.title = "Ontology" if name == CORE else f"Ontology: {name}"
        self.states = states
        self.name = name
        self.item = PathItem(
            "The core of the ontology" if self.name == CORE else f"A module of the ontology: {self.name}"
        )

    async def state(self) -> State:
        return self.states.get_or_make(self.url, 0, lambda: State(self.document))

    def document(self) -> Document:
        """Return the module; it says nothing of its URL here, so that it is the same ontology everywhere."""
        return Document(self.url, served_triples(self.name))


def ontology_route(space: Space, states: VersionCache[State], location: Location) -> Resource:
    """Return the module of the vocabulary at `/ontology` or below. Raises a 404 Problem where there is none."""
    if location.is_container:
        raise permanent_redirect(space.url("ontology", location.segments))
    name = "/".join(location.segments)
    if name == CORE:
        raise permanent_redirect(module_url(CORE, space.base))
    if not name:
        return OntologyResource(space, states)
    if name in MODULES:
        return OntologyResource(space, states, name)
    raise Problem(404, f"The ontology has no {name}: its modules are {', '.join(MODULES)}.")
