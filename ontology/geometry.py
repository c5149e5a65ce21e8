"""Geometries of messages: the places that they state, as WKT (GeoSPARQL 1.1, 8.5.1).

Positions on the earth are in WGS84, all others in the frame of the message's header, whose IRI is their coordinate
reference system. The M coordinate of such a geometry is the stamp in seconds: a frame moves, so a place in it means
something only at a time.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from functools import lru_cache
from itertools import chain
from typing import Any, NamedTuple, TypeAlias
from urllib.parse import quote

from rosld.adapters.model import Array, Message, MessageSchema, Nested
from rosld.ontology.vocab import geo, rdf, sf

CRS84 = "http://www.opengis.net/def/crs/OGC/1.3/CRS84"
"""WGS84, longitude first."""
TERMS = frozenset({geo.hasGeometry.value, geo.asWKT.value})
"""Predicates of geometries, in addition to rdf:type."""
CLASSES = frozenset({geo.Geometry.value, *(each.value for each in sf.terms.values())})
SUFFIX = ";geometry"
"""End of the fragment of a message's geometry: no field of a message can have this name."""
_MOST_POINTS = 1000
"""Maximum number of points of a path with a geometry: longer ones are elided by default."""

Fields: TypeAlias = Any
"""A message or a part of one, with the fields of its type."""
Point: TypeAlias = tuple[float, ...]


class Geometry(NamedTuple):
    """A geometry: its class in Simple Features, its points, its frame (None for WGS84), and its stamp (None: not set).

    The points of a polygon are those of its ring, the first repeated as the last. `altitude` is in metres above the
    ellipsoid, None if it is unknown or the geometry is in a frame.
    """

    kind: str
    points: Sequence[Point]
    frame: str | None = None
    stamp: str | None = None
    altitude: float | None = None

    def wkt(self, frames: str) -> str:
        """Return the text of a geo:wktLiteral; `frames` is the URL of the frames of the robot."""
        stamp = "" if self.stamp is None else f" {self.stamp}"
        tag = ("", "", "", " Z")[len(self.points[0])] + ("M" if stamp else "")
        points = ",".join([" ".join(map(repr, point)) + stamp for point in self.points])
        ring = f"({points})" if self.kind == "Polygon" else points
        crs = CRS84 if self.frame is None else frame_iri(frames, self.frame)
        return f"<{crs}> {self.kind.upper()}{tag}({ring})"


@lru_cache(maxsize=1024)
def frame_iri(frames: str, name: str) -> str:
    """Return the IRI of a frame in the document at `frames`."""
    return f"{frames}#{quote(name.encode('utf-8', 'replace'), safe='/')}"


def geometry_of(schema: MessageSchema, message: Message) -> Geometry | None:
    """Return the geometry of a message, None if it states no place (in a frame, or on the earth)."""
    read = _reader(schema)
    found = None if read is None else read(message)
    if found is None or not 1 <= len(found.points) <= _MOST_POINTS or found.frame == "":
        return None
    return found if all(map(math.isfinite, chain.from_iterable(found.points))) else None


def is_on_earth(type_name: str) -> bool:
    """Whether messages of a type state positions in WGS84, which GeoJSON takes."""
    return type_name in _ON_EARTH


def geojson_of(found: Geometry | None) -> dict[str, object] | None:
    """Return a point in WGS84 as a geometry of GeoJSON (RFC 7946, 3.1.2), None for none."""
    if found is None:
        return None
    altitude = () if found.altitude is None else (found.altitude,)
    return {"type": found.kind, "coordinates": [*found.points[0], *altitude]}


def has_place(schema: MessageSchema) -> bool:
    """Whether messages of a type may have a geometry."""
    return _reader(schema) is not None


def geometry_triples(subject: str, found: Geometry, frames: str) -> Iterator[tuple[str, str, str]]:
    """Yield the statements about a message's geometry, each as subject, predicate and object in N-Triples."""
    node = f"<{subject}{SUFFIX}>"
    yield f"<{subject}>", geo.hasGeometry.value, node
    yield node, rdf.type.value, str(geo.Geometry)
    yield node, rdf.type.value, str(sf.terms[found.kind])
    yield node, geo.asWKT.value, f'"{found.wkt(frames)}"^^{geo.wktLiteral}'


def geometry_ntriples(
    subject: str, found: Geometry, frames: str, end: str = " .\n", only: Collection[str] | None = None
) -> str:
    """Return the statements about a message's geometry as N-Triples; `only` are the needed predicates, None for all."""
    lines = geometry_triples(subject, found, frames)
    return "".join([f"{one} <{two}> {three}{end}" for one, two, three in lines if only is None or two in only])


def geometry_turtle(subject: str, found: Geometry, frames: str) -> str:
    """Return the statements about a message's geometry in Turtle, with the prefixes `geo` and `sf`."""
    return (
        f"<{subject}> geo:hasGeometry <{subject}{SUFFIX}> .\n<{subject}{SUFFIX}> a geo:Geometry, sf:{found.kind} ;\n"
        f'    geo:asWKT "{found.wkt(frames)}"^^geo:wktLiteral .\n'
    )


def geometry_jsonld(subject: str, found: Geometry, frames: str) -> str:
    """Return a member of the message's node object in JSON-LD, independent of the context."""
    classes = f'"{geo.Geometry.value}","{sf.terms[found.kind].value}"'
    value = f'{{"@type":"{geo.wktLiteral.value}","@value":"{found.wkt(frames)}"}}'
    node = f'{{"@id":"{subject}{SUFFIX}","@type":[{classes}],"{geo.asWKT.value}":{value}}}'
    return f'"{geo.hasGeometry.value}":{node}'


# --- messages

_Reader: TypeAlias = Callable[[Fields], "Geometry | None"]


@lru_cache(maxsize=1024)
def _reader(schema: MessageSchema) -> _Reader | None:
    """Return the reader of the places of a type: one in WGS84, or of the only field with a place of a stamped type."""
    if schema.ref.name in _ON_EARTH:
        return _ON_EARTH[schema.ref.name]
    fields = schema.types[schema.ref.name].fields
    if not any(field.name == "header" and field.type == Nested("std_msgs/msg/Header") for field in fields):
        return None
    found = [
        (field.attribute, *_IN_FRAME[key])
        for field in fields
        if isinstance(field.type, Array | Nested) and (key := _key(field.type)) in _IN_FRAME
    ]
    if len(found) != 1:
        return None
    ((attribute, kind, points),) = found

    def read(message: Fields) -> Geometry:
        header = message.header
        own = [(float(one.x), float(one.y), float(one.z)) for one in points(getattr(message, attribute))]
        return Geometry(kind, own, header.frame_id.removeprefix("/"), _seconds(header.stamp))

    return read


def _key(kind: Array | Nested) -> str:
    return kind.name if isinstance(kind, Nested) else f"{getattr(kind.element, 'name', '')}[]"


def _seconds(stamp: Fields) -> str | None:
    """Return a time in seconds, exactly; None for 0, which is not set."""
    if not (stamp.sec or stamp.nanosec):
        return None
    return f"{stamp.sec}.{stamp.nanosec:09}".rstrip("0").rstrip(".") if stamp.nanosec else str(stamp.sec)


class _Corner(NamedTuple):
    x: float
    y: float
    z: float


def _rectangle(info: Fields) -> Iterator[_Corner]:
    """Yield the corners of a map (nav_msgs/MapMetaData), which lies in the x and y of its origin."""
    origin, width, height = info.origin, info.width * info.resolution, info.height * info.resolution
    x, y, z, w = (getattr(origin.orientation, axis) for axis in "xyzw")
    if not (x or y or z or w):
        w = 1.0
    scale = x * x + y * y + z * z + w * w
    along = _Corner(1 - 2 * (y * y + z * z) / scale, 2 * (x * y + z * w) / scale, 2 * (x * z - y * w) / scale)
    across = _Corner(2 * (x * y - z * w) / scale, 1 - 2 * (x * x + z * z) / scale, 2 * (y * z + x * w) / scale)
    for one, other in ((0, 0), (width, 0), (width, height), (0, height), (0, 0)):
        offsets = (one * a + other * b for a, b in zip(along, across, strict=True))
        yield _Corner(*(getattr(origin.position, axis) + by for axis, by in zip("xyz", offsets, strict=True)))


def _ring(polygon: Fields) -> Sequence[Fields]:
    points = polygon.points
    return [*points, points[0]] if len(points) > 2 else ()


def _line(poses: Sequence[Fields]) -> Sequence[Fields]:
    return [one.pose.position for one in poses] if 2 <= len(poses) <= _MOST_POINTS else ()


_POINTS: Mapping[str, Callable[[Fields], Iterable[Fields]]] = {
    "Point": lambda point: (point,),
    "Pose": lambda pose: (pose.position,),
    "PoseWithCovariance": lambda pose: (pose.pose.position,),
    "Transform": lambda transform: (transform.translation,),
}
_IN_FRAME: Mapping[str, tuple[str, Callable[[Fields], Iterable[Fields]]]] = {
    **{f"geometry_msgs/msg/{name}": ("Point", read) for name, read in _POINTS.items()},
    "geometry_msgs/msg/Polygon": ("Polygon", _ring),
    "geometry_msgs/msg/PoseStamped[]": ("LineString", _line),
    "nav_msgs/msg/MapMetaData": ("Polygon", _rectangle),
}
"""Types of fields with a place: the class of the geometry, and its points."""


def _on_earth(place: Fields) -> Geometry:
    altitude = float(place.altitude)
    point = float(place.longitude), float(place.latitude)
    return Geometry("Point", [point], altitude=altitude if math.isfinite(altitude) else None)


_ON_EARTH: Mapping[str, _Reader] = {
    "sensor_msgs/msg/NavSatFix": lambda message: None if message.status.status < 0 else _on_earth(message),
    "geographic_msgs/msg/GeoPoint": _on_earth,
    "geographic_msgs/msg/GeoPointStamped": lambda message: _on_earth(message.position),
    "geographic_msgs/msg/GeoPose": lambda message: _on_earth(message.position),
    "geographic_msgs/msg/GeoPoseStamped": lambda message: _on_earth(message.pose.position),
}
