"""Types of messages that cost little to receive: no images, no point clouds, no maps, no scans."""

from __future__ import annotations

from functools import lru_cache

from rosld.adapters.model import Array, MessageSchema, Primitive

_OCTETS = frozenset({"byte", "char", "octet", "int8", "uint8", "int16", "uint16"})
"""Numbers of which an array without a bound is a picture, a cloud, a map or a sound."""
_MAX_NUMBERS = 1000
"""The most numbers in an array of a light message."""
_HEAVY = frozenset({"LaserScan", "MultiEchoLaserScan", "LaserEcho", "PointCloud", "PolygonMesh", "Mesh", "Marker"})
"""Types of other numbers without a bound of which there are many; a battery's cells and a robot's joints are few."""

_BULKY = frozenset({"PointCloud", "PolygonMesh", "Mesh"})


@lru_cache(maxsize=1024)
def is_light(schema: MessageSchema) -> bool:
    """Whether messages of a type, with those within, are small as a rule."""
    kinds = schema.types.values()
    if any(kind.name.rpartition("/")[2] in _HEAVY for kind in kinds):
        return False
    return not any(_is_many(field.type) for kind in kinds for field in kind.fields)


@lru_cache(maxsize=1024)
def is_bulky(schema: MessageSchema) -> bool:
    """Whether messages of a type are pictures, clouds, maps or sounds: what nobody receives by the way."""
    kinds = schema.types.values()
    if any(kind.name.rpartition("/")[2] in _BULKY for kind in kinds):
        return True
    arrays = (field.type for kind in kinds for field in kind.fields if isinstance(field.type, Array))
    return any(
        isinstance(one.element, Primitive) and one.element.name in _OCTETS and (one.length or one.bound) is None
        for one in arrays
    )


def _is_many(kind: object) -> bool:
    if not isinstance(kind, Array) or not isinstance(kind.element, Primitive):
        return False
    longest = kind.length if kind.length is not None else kind.bound
    return kind.element.name in _OCTETS if longest is None else longest > _MAX_NUMBERS
