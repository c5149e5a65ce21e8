"""Point clouds of any layout as PLY files, read by plyfile; inconsistent ones are refused with a reason."""

from __future__ import annotations

import io
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from rosld.server.pictures.picture_cache import CannotDraw
from rosld.server.space.point_cloud import cloud_ply, read_cloud

PlyData = pytest.importorskip("plyfile").PlyData
DATATYPES = {"i1": 1, "u1": 2, "i2": 3, "u2": 4, "i4": 5, "u4": 6, "f4": 7, "f8": 8}


def cloud(points: np.ndarray, row_gap: int = 0, **changes: Any) -> SimpleNamespace:
    """Return a sensor_msgs/PointCloud2 of structured points, in rows with a gap after each."""
    rows = np.atleast_2d(points)
    data = b"".join(each.tobytes() + b"\xff" * row_gap for each in rows)
    kinds = points.dtype.fields
    fields = [
        SimpleNamespace(name=name, offset=kinds[name][1], datatype=DATATYPES[kinds[name][0].str[1:]], count=1)
        for name in points.dtype.names
    ]
    values = {
        "header": SimpleNamespace(frame_id="/lidar\n", stamp=SimpleNamespace(sec=1, nanosec=5)),
        "height": rows.shape[0], "width": rows.shape[1], "fields": fields, "point_step": points.dtype.itemsize,
        "row_step": rows.shape[1] * points.dtype.itemsize + row_gap, "data": np.frombuffer(data, np.uint8),
        "is_bigendian": kinds[points.dtype.names[0]][0].str[0] == ">", "is_dense": False,
    }  # fmt: skip
    return SimpleNamespace(**{**values, **changes})


def vertices(message: SimpleNamespace, most: int = 20_000) -> Any:
    return PlyData.read(io.BytesIO(cloud_ply(read_cloud(message, most))))["vertex"]


@pytest.mark.parametrize("order", ["<", ">"])
def test_any_layout_is_read_organised_padded_and_of_either_order(order: str) -> None:
    kind = np.dtype(
        {"names": ["z", "x", "y", "intensity", "rgb"],
         "formats": [f"{order}{each}" for each in ("f8", "f4", "i2", "u2", "f4")],
         "offsets": [3, 16, 12, 24, 28], "itemsize": 40}
    )  # fmt: skip
    points = np.zeros((2, 3), kind)
    points["x"], points["y"], points["z"] = [[1, 2, np.nan], [4, 5, 6]], -7, [[0.5, np.inf, 1], [1, 1, 1e300]]
    points["intensity"] = 500
    points["rgb"] = np.array([0x102030], f"{order}u4").view(f"{order}f4")[0]
    found = vertices(cloud(points, row_gap=5))
    assert found["x"].tolist() == [1, 4, 5]
    assert found["y"].tolist() == [-7] * 3
    assert found["z"].tolist() == [0.5, 1, 1]
    assert found["intensity"].tolist() == [500] * 3
    assert [found[each][0] for each in ("red", "green", "blue")] == [0x10, 0x20, 0x30]


def test_many_points_are_thinned_to_as_many_as_are_asked_for_from_first_to_last() -> None:
    points = np.zeros(200_000, [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("r", "u1"), ("g", "u1"), ("b", "u1")])
    points["x"] = np.arange(200_000)
    points["g"] = 9
    found = vertices(cloud(points), 777)
    assert found.count == 777
    assert (found["x"][0], found["x"][-1]) == (0, 199_999)
    assert len(np.unique(np.diff(found["x"]))) == 2, "evenly, and at no whole step that could leave out a ring"
    assert set(found["green"]) == {9}


XYZ = [("x", "<f4"), ("y", "<f4"), ("z", "<f4")]


def test_a_cloud_that_contradicts_itself_is_refused_in_words() -> None:
    refused: tuple[tuple[dict[str, Any], str], ...] = (
        ({"point_step": 0}, "The points are 0 bytes long"),
        ({"height": 2, "row_step": 20}, "Rows of 20 bytes are too short for 4 points"),
        ({"width": 5}, "has 48 bytes, but 5 by 1 points need 60"),
        ({"height": 2**32 - 1, "width": 2**32 - 1, "row_step": 2**32 - 1}, "are too short for"),
        ({"point_step": 8}, "The field 'z' reaches to byte 11 of points of 8 bytes"),
        ({"fields": []}, "The points have no field 'x'"),
        ({"data": np.zeros(0, np.uint8)}, "has 0 bytes"),
    )
    for changes, words in refused:
        with pytest.raises(CannotDraw, match=words):
            read_cloud(cloud(np.zeros(4, XYZ), **changes))


def test_a_cloud_without_points_is_a_file_without_points() -> None:
    assert vertices(cloud(np.zeros(0, XYZ), fields=[], point_step=0)).count == 0
