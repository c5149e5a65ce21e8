"""The description of the server as a dataset, at the well-known URL of VoID."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from functools import partial

from rosld.ontology.describe_datasets import void_document
from rosld.ontology.document import Document
from rosld.server.history.recordings import Recordings
from rosld.server.resources.bags import bag_urls
from rosld.server.rest.path_item import PathItem
from rosld.server.rest.resource import RDF_SOURCE, RESOURCE, Resource
from rosld.server.rest.state import State
from rosld.server.robot.session import Session
from rosld.server.runtime.version_cache import VersionCache


class DatasetResource(Resource):
    """`/.well-known/void`: the dataset (VoID 7.2), and the catalogue of recordings (DCAT)."""

    kind = "Dataset"
    shape = "DatasetDescription"
    title = "Description of the dataset"
    item = PathItem("The description of the dataset, and the catalogue of recordings")
    links = (RESOURCE, RDF_SOURCE)

    def __init__(self, session: Session, states: VersionCache[State], recordings: Recordings) -> None:
        super().__init__(session.space, f"{session.space.base}.well-known/void")
        self._session = session
        self._states = states
        self._recordings = recordings

    async def state(self) -> State:
        version, describe = self.outline()
        return self._states.get_or_make(self.url, version, lambda: State(describe))

    def outline(self) -> tuple[Hashable, Callable[[], Document]]:
        """Return a token that changes with the description, and a function for the description."""
        version = self._session.name, bag_urls(self.space, self._recordings)
        return version, partial(void_document, self.url, self.space, *version)
