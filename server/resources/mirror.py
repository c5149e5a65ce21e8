"""`/mirror`: the progress of the replication to another store (`--store`)."""

from __future__ import annotations

from collections.abc import Sequence

import orjson
from pyoxigraph import NamedNode

from rosld.ontology.document import Document
from rosld.ontology.triples import RDF_SOURCE, date_time_literal, double, integer, text, triples_about
from rosld.ontology.urls import Space
from rosld.ontology.vocab import dcterms, rdf, ros
from rosld.server.dataset.replication import Mirror, ReplicationStatus
from rosld.server.hypermedia.message_schemas import MessageSchemas
from rosld.server.resources.mirror_setup import ROUTE
from rosld.server.rest.path_item import PathItem
from rosld.server.rest.resource import Resource
from rosld.server.rest.state import State


class ReplicationResource(Resource):
    """The progress of the replication to another store."""

    kind = "Mirror"

    def __init__(self, space: Space, mirror: Mirror) -> None:
        super().__init__(space.base + ROUTE)
        self._mirror = mirror
        self._shape = space.document_shape("Mirror")

    def path_item(self, schemas: MessageSchemas) -> PathItem:
        return PathItem("The mirror of the dataset in another store")

    @property
    def conforms_to(self) -> Sequence[str]:
        return (self._shape,)

    async def state(self) -> State:
        status = self._mirror.status
        return State(lambda: replication_document(self.url, status), lambda: _plain(status))


def replication_document(url: str, status: ReplicationStatus) -> Document:
    """A mirror described. It is stale, with the reason, while its store cannot be told anything."""
    return Document(
        url,
        tuple(
            triples_about(
                NamedNode(url),
                (rdf.type, ros.Mirror),
                *RDF_SOURCE,
                (ros.store, NamedNode(status.url)),
                (ros.state, ros.Live if status.failure is None else ros.Stale),
                (ros.reason, text(status.failure)),
                (ros.words, text(status.words)),
                (ros.lag, double(round(status.lag, 3))),
                (ros.pending, integer(status.pending)),
                (ros.refusedGraphs, integer(status.refused)),
                (dcterms.modified, date_time_literal(status.updated_ns)),
            )
        ),
    )


def _plain(status: ReplicationStatus) -> bytes:
    return orjson.dumps(
        {
            "store": status.url,
            "failure": status.failure,
            "words": status.words,
            "lag": round(status.lag, 3),
            "pending": status.pending,
            "refused": status.refused,
        }
    )
