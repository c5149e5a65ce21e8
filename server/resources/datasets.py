"""The description of the server as a dataset, at the well-known URL of VoID."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from functools import partial

from rosld.ontology.describe_datasets import void_document
from rosld.ontology.document import Document
from rosld.server.resources.bags import bag_urls
from rosld.server.resources.base import SessionResource
from rosld.server.rest.path_item import PathItem
from rosld.server.rest.resource import RDF_SOURCE, RESOURCE
from rosld.server.rest.state import State


class DatasetResource(SessionResource):
    """`/.well-known/void`: the dataset (VoID 7.2), and the catalogue of recordings (DCAT)."""

    kind = "Dataset"
    shape = "DatasetDescription"
    title = "Description of the dataset"
    path = ".well-known/void"
    item = PathItem("The description of the dataset, and the catalogue of recordings")
    links = (RESOURCE, RDF_SOURCE)

    async def state(self) -> State:
        version, describe = self.outline()
        return self.states.get_or_make(self.url, version, lambda: State(describe))

    def outline(self) -> tuple[Hashable, Callable[[], Document]]:
        """Return a token that changes with the description, and a function for the description."""
        version = self.session.name, bag_urls(self.space, self.services.recordings)
        return version, partial(void_document, self.url, self.space, *version)
