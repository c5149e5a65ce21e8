"""Point clouds of topics and recorded messages, as files of points by content negotiation."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

from starlette.responses import Response

from rosld.adapters.model import RosError, Sample, TypeRef
from rosld.server.http.conditional import ETag
from rosld.server.http.negotiation import choose_offer
from rosld.server.http.problem import ROBOT_SAID, Problem
from rosld.server.pictures.picture_cache import PictureCache
from rosld.server.pictures.refusal import CannotDraw
from rosld.server.resources.pictures import VERSION, sample_identity
from rosld.server.rest.exchange import Exchange
from rosld.server.rest.formats import FORMATS, OFFERS
from rosld.server.rest.path_item import BYTES, QueryParameter
from rosld.server.rest.resource import Resource
from rosld.server.rest.responses import bytes_response, resource_headers
from rosld.server.robot.schemas import Schemas
from rosld.server.space.ply import draw_cloud
from rosld.server.space.point_cloud import DEFAULT_POINTS, MAX_POINTS, POINT_CLOUD

PLY = BYTES
"""IANA has registered no media type for PLY."""
CLOUD_PARAMETERS = (
    VERSION,
    QueryParameter(
        "format", "The representation wanted, before Accept.", {"type": "string", "enum": [*FORMATS, "ply"]}
    ),
    QueryParameter("points", "The most points of the file.", {"type": "integer", "minimum": 1, "maximum": MAX_POINTS}),
)
_MAX_NAME = 20


def is_cloud(type_name: str) -> bool:
    """Whether messages of a type are point clouds."""
    return type_name == POINT_CLOUD


def cloud_is_preferred(exchange: Exchange, *, is_cloud: bool) -> bool:
    """Whether a request prefers a file of points to all else; `?format=ply` wants one whatever there is."""
    if b"field=" in exchange.request.scope["query_string"]:
        return False
    if b"format=" in exchange.request.scope["query_string"] and exchange.query.get("format"):
        return exchange.query["format"] == "ply"
    accept = exchange.accept
    if not is_cloud or accept is None or "application/octet-stream" not in accept.lower():
        return False
    return choose_offer(accept, (*OFFERS, PLY)) == PLY


def require_cloud(name: str, types: Sequence[TypeRef]) -> None:
    """Raise a 406 Problem where messages of these types are no point clouds."""
    if not any(is_cloud(ref.name) for ref in types):
        said = ", ".join(ref.name for ref in types) or "an unknown type"
        words = f"{name} has messages of {said}: only {POINT_CLOUD} is read as a file of points."
        raise Problem(406, f"{words} There are {', '.join(OFFERS)}.")


async def cloud_response(
    resource: Resource, schemas: Schemas, files: PictureCache, name: str, sample: Sample, exchange: Exchange
) -> Response:
    """The file of a sample's points, 304 where it is known. Raises Problems."""
    require_cloud(name, (sample.schema,))
    most = _points(exchange.query.get("points"))
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


def _points(text: str | None) -> int:
    if text is None:
        return DEFAULT_POINTS
    if not (text.isascii() and text.isdecimal() and 1 <= int(text[:9]) <= MAX_POINTS):
        raise Problem(400, f"?points={text[:_MAX_NAME]}: a whole number of points from 1 to {MAX_POINTS}.")
    return int(text)
