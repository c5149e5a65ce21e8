"""Drawings of messages: valid points, lines of limited length, and refusals with reasons."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from rosld.adapters.model import Encoding, MessageSchema, Sample, TypeRef
from rosld.adapters.model.library import TypeLibrary
from rosld.ontology.lower import lowerer
from rosld.server.pictures.picture_cache import CannotDraw
from rosld.server.space.drawing import MAX_POINTS, Drawing, drawing_json, place_sample

SCAN = {"header": {"frame_id": "/laser"}, "angle_increment": 0.1, "range_min": 0.5, "range_max": 8.0}
UPRIGHT = {"orientation": {"w": 1.0}}
LIBRARY = TypeLibrary(ros_version=2)


def drawn(type_name: str, value: dict[str, Any]) -> Drawing:
    """Return the drawing of a message, given by its JSON; missing fields have defaults."""
    schema = LIBRARY.find(TypeRef(type_name))
    assert isinstance(schema, MessageSchema)
    data = schema.codec.encode(lowerer(schema).from_json(value, defaults=True), Encoding.CDR)
    return place_sample(schema, Sample(data, Encoding.CDR, schema.ref, "", 1, 1))


def test_of_a_scan_only_what_was_measured_is_a_point() -> None:
    ranges = [1.0, "NaN", "INF", 0.1, 9.0, 2.0]
    drawing = drawn("sensor_msgs/msg/LaserScan", {**SCAN, "ranges": ranges})
    assert drawing.frame == "laser"
    assert drawing.points == pytest.approx(np.array([[1, 0, 0], [2 * math.cos(0.5), 2 * math.sin(0.5), 0]]))
    assert set(drawing_json(drawing)["points"]) == {"x", "y"}  # type: ignore[call-overload]


def test_long_messages_are_thinned_and_keep_their_ends() -> None:
    poses = [{"pose": {**UPRIGHT, "position": {"x": float(each)}}} for each in range(2 * MAX_POINTS)]
    line = drawn("nav_msgs/msg/Path", {"poses": poses}).line
    assert line is not None
    assert MAX_POINTS / 2 < len(line) <= MAX_POINTS
    assert line[-1][0] == 2 * MAX_POINTS - 1


def test_an_ellipse_has_the_axes_of_the_covariance() -> None:
    covariance = np.zeros((6, 6))
    covariance[:2, :2] = [[2.5, 1.5], [1.5, 2.5]]  # 4 along the diagonal, 1 across
    pose = {"pose": {"pose": UPRIGHT, "covariance": covariance.ravel().tolist()}}
    ellipse = drawn("geometry_msgs/msg/PoseWithCovarianceStamped", pose).ellipse
    assert ellipse is not None
    assert (ellipse.major, ellipse.minor) == (2, 1)
    assert math.tan(ellipse.angle) == pytest.approx(1, abs=1e-3)
    pose["pose"]["covariance"][0] = "NaN"
    assert drawn("geometry_msgs/msg/PoseWithCovarianceStamped", pose).ellipse is None


def test_a_message_without_a_place_is_refused_in_words() -> None:
    refused: tuple[tuple[str, dict[str, Any], str], ...] = (
        ("geometry_msgs/msg/PoseStamped", {"pose": {"orientation": {"w": "NaN"}}}, "is not a rotation"),
        ("geometry_msgs/msg/PointStamped", {"point": {"x": "NaN"}}, "nan is not a coordinate"),
        ("nav_msgs/msg/OccupancyGrid", {"info": {"resolution": 0.0}}, "cells of the grid are 0 m wide"),
        ("sensor_msgs/msg/LaserScan", {**SCAN, "angle_increment": "NaN", "ranges": [1.0]}, "are not numbers"),
        ("std_msgs/msg/String", {}, "cannot be drawn in space"),
    )
    for type_name, value, words in refused:
        with pytest.raises(CannotDraw, match=words):
            drawn(type_name, value)
