"""Messages in resources: decoded, lifted, or a single field of one."""

from __future__ import annotations

from msgspec import Struct
from starlette.responses import Response

from rosld.adapters.model import Message, MessageSchema, RosError, Sample
from rosld.ontology.document import Envelope, LiftedMessage
from rosld.ontology.fields import field_bytes
from rosld.ontology.lift import LiftSettings, lifter
from rosld.ontology.urls import Space
from rosld.server.http.problem import Problem
from rosld.server.robot.schemas import Schemas


class DecodedSample(Struct, frozen=True, eq=False):
    """A sample with its message, or with the reason why it cannot be read."""

    sample: Sample
    schema: MessageSchema | None
    message: Message | None
    reason: str | None = None


async def decode(schemas: Schemas, sample: Sample) -> DecodedSample:
    """Return a sample's message, or why it cannot be read."""
    try:
        schema = await schemas.message(sample.schema)
        return DecodedSample(sample, schema, schema.codec.decode(sample.data, sample.encoding))
    except (RosError, ValueError) as error:
        return DecodedSample(sample, None, None, str(error))


def lift_sample(space: Space, lifting: LiftSettings, one: DecodedSample) -> LiftedMessage:
    """Return a decoded sample as the `#message` of a document."""
    assert one.schema is not None
    assert one.message is not None
    publisher = space.node(one.sample.publisher) if one.sample.publisher else None
    envelope = Envelope(one.sample.received_ns, one.sample.sequence, publisher)
    return LiftedMessage("#message", lifter(one.schema, lifting), one.message, envelope)


async def field_response(schemas: Schemas, sample: Sample, path: str) -> Response:
    """Return the bytes of one field of a message; a 404 Problem where it has none of that path."""
    decoded = await decode(schemas, sample)
    if decoded.schema is None or decoded.message is None:
        raise Problem(406, f"The message cannot be read: {decoded.reason}.")
    try:
        data, media_type = field_bytes(decoded.schema, decoded.message, path)
    except ValueError as error:
        raise Problem(404, str(error)) from error
    return Response(data, media_type=media_type, headers={"Cache-Control": "no-cache"})
