"""Point clouds as files: binary PLY, which CloudCompare, MeshLab, Blender, Open3D and PCL open. Pure, for a thread."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from rosld.adapters.model import MessageSchema, Sample
from rosld.server.pictures.refusal import CannotDraw
from rosld.server.space.point_cloud import POINT_CLOUD, Cloud, read_cloud

_NAMES = {"<f4": "float", "|u1": "uchar"}


def draw_cloud(schema: MessageSchema, sample: Sample, most: int) -> bytes:
    """The PLY file of at most so many points of a sample. Raises CannotDraw, and ValueError for what is no message."""
    if schema.ref.name != POINT_CLOUD:
        raise CannotDraw(f"A {schema.ref.name} is no point cloud")
    message = schema.codec.decode(sample.data, sample.encoding)
    try:
        return cloud_ply(read_cloud(message, most))
    except (AttributeError, TypeError) as error:
        raise CannotDraw(f"The message has other fields than a {schema.ref.name}") from error
    except OverflowError as error:
        raise CannotDraw(f"{error}") from error


def cloud_ply(cloud: Cloud) -> bytes:
    """A cloud as binary PLY, little endian: x, y, z; red, green, blue as uchar; intensity. Of these what there is."""
    columns: dict[str, npt.NDArray[np.generic]] = {name: cloud.points[:, place] for place, name in enumerate("xyz")}
    if cloud.colours is not None:
        columns |= {name: cloud.colours[:, place] for place, name in enumerate(("red", "green", "blue"))}
    if cloud.intensity is not None:
        columns["intensity"] = cloud.intensity
    kinds = [(name, "|u1" if values.dtype == np.uint8 else "<f4") for name, values in columns.items()]
    rows = np.empty(len(cloud.points), kinds)
    for name, values in columns.items():
        rows[name] = values
    head = [
        "ply",
        "format binary_little_endian 1.0",
        f"comment frame {_one_line(cloud.frame)}",
        f"comment stamp {cloud.stamp_ns} ns",
        f"comment points {len(rows)} of {cloud.total}",
        f"element vertex {len(rows)}",
        *(f"property {_NAMES[kind]} {name}" for name, kind in kinds),
        "end_header",
    ]
    return "".join(f"{line}\n" for line in head).encode("ascii") + rows.tobytes()


def _one_line(text: str) -> str:
    """A name as the header, which is ASCII by lines, can hold it."""
    return ascii(text)[1:-1]
