"""Messages in resources: decoding, lifting, single fields, pictures and files of points."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial

import orjson
from msgspec import Struct
from starlette.responses import Response

from rosld.adapters.base import Watch
from rosld.adapters.model import Message, MessageSchema, RosError, Sample, TypeRef
from rosld.ontology.document import Envelope, LiftedMessage
from rosld.ontology.fields import field_bytes
from rosld.ontology.geometry import geojson_of, geometry_of
from rosld.ontology.lift import LiftSettings, lifter
from rosld.ontology.literals import date_time
from rosld.ontology.observations import Observer, Role
from rosld.ontology.urls import Space
from rosld.server.http.conditional import ETag, digest
from rosld.server.http.problem import ROBOT_SAID, Problem
from rosld.server.pictures.picture_cache import (
    DEFAULT_RANGE,
    DRAWN_TYPES,
    JPEG,
    PNG,
    CannotDraw,
    DepthRange,
    PictureCache,
    PictureForm,
    UnknownPicture,
    can_draw,
)
from rosld.server.rest.exchange import Exchange
from rosld.server.rest.formats import FORMATS, OFFERS
from rosld.server.rest.path_item import BYTES, QueryParameter
from rosld.server.rest.resource import Motion, Resource
from rosld.server.rest.responses import bytes_response, resource_headers
from rosld.server.robot.schemas import Schemas
from rosld.server.robot.session import Session
from rosld.server.space.point_cloud import DEFAULT_POINTS, MAX_POINTS, POINT_CLOUD, draw_cloud


class DecodedSample(Struct, frozen=True, eq=False):
    """A sample with its message, or with the reason why it is unreadable."""

    sample: Sample
    schema: MessageSchema | None
    message: Message | None
    reason: str | None = None


async def decode(schemas: Schemas, sample: Sample) -> DecodedSample:
    """Return a sample's message, or the reason why it is unreadable."""
    try:
        schema = await schemas.message(sample.schema)
        return DecodedSample(sample, schema, schema.codec.decode(sample.data, sample.encoding))
    except (RosError, ValueError) as error:
        return DecodedSample(sample, None, None, str(error))


def lift_sample(
    space: Space, lifting: LiftSettings, one: DecodedSample, topic: str = "", role: Role | None = None
) -> LiftedMessage:
    """Return a decoded sample as the `#message` of a document; its `role` is that of messages of the topic."""
    assert one.schema is not None
    assert one.message is not None
    publisher = space.node(one.sample.publisher) if one.sample.publisher else None
    envelope = Envelope(one.sample.received_ns, one.sample.sequence, publisher)
    device = "" if role is None else space.topic(topic) + role.value
    observer = None if role is None else Observer(one.schema, role, lifting.types, device, space.base)
    lift = lifter(one.schema, lifting)
    return LiftedMessage("#message", lift, one.message, envelope, frames=space.frames, observer=observer)


async def field_response(schemas: Schemas, sample: Sample, path: str) -> Response:
    """Return the bytes of one field of a message. Raises a 404 Problem if there is no field at the path."""
    decoded = await decode(schemas, sample)
    if decoded.schema is None or decoded.message is None:
        raise Problem(406, f"The message cannot be read: {decoded.reason}.")
    try:
        data, media_type = field_bytes(decoded.schema, decoded.message, path)
    except ValueError as error:
        raise Problem(404, str(error)) from error
    return Response(data, media_type=media_type, headers={"Cache-Control": "no-cache"})


MOTION = "multipart/x-mixed-replace"
PICTURES = (JPEG, PNG, MOTION)
"""Additional media types of topics with images, default first."""
PICTURE_FORMATS = {"jpeg": JPEG, "png": PNG, "mjpeg": MOTION}
MAX_WIDTH = 8192
_MAX_NAME = 20
PICTURE_FORMAT = QueryParameter(
    "format",
    "The requested representation; overrides Accept.",
    {"type": "string", "enum": [*FORMATS, *PICTURE_FORMATS]},
)
VERSION = QueryParameter("v", "Ignored; pages add it to get a new URL for each message.")
PICTURE_PARAMETERS = (
    VERSION,
    QueryParameter(
        "width", "The maximum width of the picture in pixels.", {"type": "integer", "minimum": 1, "maximum": MAX_WIDTH}
    ),
    QueryParameter("range", "The distances in metres from the nearest to the farthest colour, such as `0.5,4`."),
)
_NAMES = {JPEG: "jpeg", PNG: "png"}


def picture_type(exchange: Exchange, *, is_picture: bool) -> str | None:
    """Return the media type of the picture that a request prefers, or None if it prefers another format.

    Raises a 406 Problem if no offered format is acceptable, images included.
    """
    if not is_picture:
        return explicit_picture_type(exchange)
    found = exchange.preferred(PICTURE_FORMATS, (*OFFERS, *PICTURES))
    accept = exchange.accept or ""
    if found is None and exchange.format is None and ("image/" in accept or "multipart/" in accept):
        raise Problem(406, f"None of {accept!r} is available; choose from {', '.join((*OFFERS, *PICTURES))}.")
    return found if found in PICTURES else None


def explicit_picture_type(exchange: Exchange) -> str | None:
    """Return the media type of a picture if the request accepts only pictures, else None."""
    if exchange.preferred(FORMATS, OFFERS) is not None:
        return None
    return exchange.preferred(PICTURE_FORMATS, (JPEG, PNG))


def require_picture(name: str, types: Sequence[TypeRef]) -> None:
    """Raise a 406 Problem if messages of these types are not drawable."""
    if not any(can_draw(ref.name) for ref in types):
        raise _unfit(name, types, f"{', '.join(DRAWN_TYPES)} are drawn as pictures")


def _unfit(name: str, types: Sequence[TypeRef], what_is: str) -> Problem:
    names = ", ".join(ref.name for ref in types) or "an unknown type"
    return Problem(406, f"{name} has messages of {names}: only {what_is}. There are {', '.join(OFFERS)}.")


async def picture_response(
    resource: Resource,
    schemas: Schemas,
    pictures: PictureCache,
    name: str,
    sample: Sample,
    exchange: Exchange,
    media_type: str,
) -> Response:
    """Return the picture of a sample, or 304 if the client has it. Raises Problems."""
    if media_type not in _NAMES:
        raise Problem(406, "This picture does not move: ask for image/jpeg or image/png.")
    form = _form(exchange, media_type)
    schema = await _schema(schemas, sample)
    etag = ETag(f"{pictures.instance_id}-{sample_identity(sample)}", _variant(form))
    fixed_headers = {**resource_headers(resource), "x-content-type-options": "nosniff"}
    is_known = exchange.check_preconditions(etag)
    data = b"" if is_known else await _draw(pictures, name, schema, sample, form)
    return bytes_response(exchange, data, media_type, etag, fixed_headers.items())


async def picture_motion(
    session: Session, pictures: PictureCache, name: str, first: Sample | None, exchange: Exchange
) -> Motion:
    """Return a stream of a topic's pictures; the first is drawn at once to detect errors. Raises Problems."""
    form = _form(exchange, JPEG)
    if first is not None:
        await _draw(pictures, name, await _schema(session.schemas, first), first, form)
    last: Sample | None = None

    async def newest() -> bytes | None:
        nonlocal last
        view = session.topics.find_view(name)
        sample = None if view is None else view.newest
        if sample is None or sample is last:
            return None
        last = sample
        try:
            return await _draw(pictures, name, await _schema(session.schemas, sample), sample, form)
        except Problem:
            return None  # the next picture may be drawable again

    async def watch(wake: Callable[[], None]) -> Watch:
        return await session.topics.watch(name, wake)

    return Motion(JPEG, watch, newest)


async def _schema(schemas: Schemas, sample: Sample) -> MessageSchema:
    require_picture("This", (sample.schema,))
    try:
        return await schemas.message(sample.schema)
    except RosError as error:
        raise Problem(406, f"The message cannot be read: {error}.") from error


async def _draw(pictures: PictureCache, name: str, schema: MessageSchema, sample: Sample, form: PictureForm) -> bytes:
    try:
        return await pictures.picture(name, schema, sample, form)
    except UnknownPicture as error:
        raise Problem(406, f"{error}.", extra={ROBOT_SAID: error.words}) from error
    except CannotDraw as error:
        raise Problem(422, f"{error}.", extra={ROBOT_SAID: error.words}) from error
    except ValueError as error:
        raise Problem(406, f"The message cannot be read: {error}.") from error


def _form(exchange: Exchange, media_type: str) -> PictureForm:
    """Return the form of a requested picture. Raises 400 Problems."""
    width = exchange.query_integer("width", 0, 1, MAX_WIDTH) or None
    return PictureForm(media_type, width, _range(exchange.query.get("range")))


def _range(text: str | None) -> DepthRange:
    if text is None:
        return DEFAULT_RANGE
    nearest, _, farthest = text.partition(",")
    try:
        found = DepthRange(float(nearest), float(farthest))
    except ValueError:
        found = DepthRange(math.nan, math.nan)
    if not (-1e9 < found.nearest < found.farthest < 1e9):
        raise Problem(
            400, f"?range={text[:_MAX_NAME]} must be two distances in metres, the nearer first, such as 0.5,4."
        )
    return found


def sample_identity(sample: Sample) -> str:
    """Return a short text that identifies a sample within its topic."""
    key = f"{sample.publisher}\0{sample.epoch}\0{sample.sequence}\0{sample.received_ns}"
    return digest(key.encode("utf-8", "replace"))


def _variant(form: PictureForm) -> str:
    width = "" if form.width is None else f"-{form.width}"
    shown = "" if form.shown == DEFAULT_RANGE else f"-{digest(repr(form.shown).encode())}"
    return f"{_NAMES[form.media_type]}{width}{shown}"


PLY = BYTES
"""IANA has registered no media type for PLY."""
CLOUD_PARAMETERS = (
    VERSION,
    QueryParameter(
        "format", "The requested representation; overrides Accept.", {"type": "string", "enum": [*FORMATS, "ply"]}
    ),
    QueryParameter(
        "points", "The maximum number of points in the file.", {"type": "integer", "minimum": 1, "maximum": MAX_POINTS}
    ),
)


def is_cloud(type_name: str) -> bool:
    """Whether messages of a type are point clouds."""
    return type_name == POINT_CLOUD


def cloud_is_preferred(exchange: Exchange, *, is_cloud: bool) -> bool:
    """Whether a request prefers a file of points (or demands it by `?format=ply`)."""
    return (
        "field" not in exchange.query
        and exchange.preferred({"ply": PLY}, (*OFFERS, PLY) if is_cloud else OFFERS) == PLY
    )


def require_cloud(name: str, types: Sequence[TypeRef]) -> None:
    """Raise a 406 Problem if messages of these types are not point clouds."""
    if not any(is_cloud(ref.name) for ref in types):
        raise _unfit(name, types, f"{POINT_CLOUD} is read as a file of points")


async def cloud_response(
    resource: Resource, schemas: Schemas, files: PictureCache, name: str, sample: Sample, exchange: Exchange
) -> Response:
    """Return the file of a sample's points, or 304 if the client has it. Raises Problems."""
    require_cloud(name, (sample.schema,))
    most = exchange.query_integer("points", DEFAULT_POINTS, 1, MAX_POINTS)
    etag = ETag(f"{files.instance_id}-{sample_identity(sample)}", f"ply-{most}")
    try:
        schema = await schemas.message(sample.schema)
        draw = partial(draw_cloud, most=most)
        data = await files.file(name, schema, sample, ("ply", most), draw)
    except CannotDraw as error:
        raise Problem(422, f"{error}.", extra={ROBOT_SAID: error.words}) from error
    except (RosError, ValueError) as error:
        raise Problem(406, f"The message cannot be read: {error}.") from error
    headers = {
        **resource_headers(resource),
        "x-content-type-options": "nosniff",
        "content-disposition": 'attachment; filename="points.ply"',
    }
    return bytes_response(exchange, data, PLY, etag, headers.items())


GEO_JSON = "application/geo+json"
GEO_FORMAT = QueryParameter(
    "format", "The requested representation; overrides Accept.", {"type": "string", "enum": [*FORMATS, "geojson"]}
)


PARTS = (*OFFERS, *PICTURES, PLY, GEO_JSON)
"""Media types of topics and of all parts of their messages."""


def geojson_is_preferred(exchange: Exchange) -> bool:
    """Whether a request prefers GeoJSON (or demands it by `?format=geojson`) of messages on the earth."""
    return exchange.preferred({"geojson": GEO_JSON}, (*OFFERS, GEO_JSON)) == GEO_JSON


async def geojson_response(
    resource: Resource, schemas: Schemas, sample: Sample, exchange: Exchange, instance_id: str
) -> Response:
    """Return a sample as a Feature of GeoJSON (RFC 7946), whose geometry is null without a fix. Raises Problems."""
    decoded = await decode(schemas, sample)
    if decoded.schema is None or decoded.message is None:
        raise Problem(406, f"The message cannot be read: {decoded.reason}.")
    feature = {
        "type": "Feature",
        "id": f"{resource.url}#message",
        "geometry": geojson_of(geometry_of(decoded.schema, decoded.message)),
        "properties": {"received": date_time(0, sample.received_ns)},
    }
    etag = ETag(f"{instance_id}-{sample_identity(sample)}", "geojson")
    return bytes_response(exchange, orjson.dumps(feature), GEO_JSON, etag, resource_headers(resource).items())
