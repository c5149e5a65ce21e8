"""Resources whose writes command the robot."""

from __future__ import annotations

from rosld.ontology.document import Document
from rosld.server.resources.accepted_shape import AcceptedShape
from rosld.server.rest.exchange import Exchange
from rosld.server.rest.resource import Resource
from rosld.server.robot.session import Session

WRITES = frozenset({"PUT", "POST", "PATCH", "DELETE"})


class CommandResource(Resource):
    """Base of the resources whose writes command the robot: none is offered while it is stopped."""

    session: Session

    @property
    def withheld(self) -> frozenset[str]:
        return WRITES if self.session.is_stopped else frozenset()

    async def accepted(self, url: str) -> Document | None:
        """What may be written to it as RDF, as the shapes graph at `url`; None where no shape of its own says so."""
        return None

    async def select_variant(self, exchange: Exchange) -> Resource:
        """The shape of what may be written, where `?shape` asks for that."""
        query: bytes = exchange.request.scope["query_string"]
        if b"shape" in query and exchange.method in ("GET", "HEAD") and "shape" in exchange.query:
            return AcceptedShape(self, self.accepted)
        return self
