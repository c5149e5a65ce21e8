"""yourdfpy, a parser of URDF, reads the same links, joints, axes, origins and limits."""

from __future__ import annotations

from collections.abc import Iterator
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest

from rosld.ontology.urdf import Joint, read_urdf
from rosld.server.space.transforms import Transform, multiply, rotate
from tests.ontology.test_urdf import ARM

yourdfpy = pytest.importorskip("yourdfpy", reason="yourdfpy is missing: pip install '.[interop]'")
pytest.importorskip("jvrc_description", reason="jvrc-description is missing: pip install '.[interop]'")


def descriptions() -> Iterator[tuple[str, str]]:
    """Yield names and texts: of a humanoid with 59 joints, of the rover, and of the tests' arm."""
    places = (("jvrc_description", "urdf/jvrc1.urdf"), ("rosld.adapters.rover", "rover.urdf"))
    yield from ((path, (files(package) / path).read_text("utf-8")) for package, path in places)
    yield "arm", ARM.partition("\n")[2]


def matrix(joint: Joint) -> np.ndarray:
    """Return the origin of a joint as a matrix: the rotation about x, then y, then z, and the translation."""
    rotation = (0.0, 0.0, 0.0, 1.0)
    for axis, angle in enumerate(joint.rpy):
        turn = [0.0, 0.0, 0.0, np.cos(angle / 2)]
        turn[axis] = np.sin(angle / 2)
        rotation = multiply(tuple(turn), rotation)
    found = np.eye(4)
    found[:3, :3] = np.array([rotate(rotation, tuple(each)) for each in np.eye(3)]).T
    found[:3, 3] = Transform(joint.xyz, rotation).translation
    return found


@pytest.mark.parametrize(("name", "text"), list(descriptions()))
def test_both_read_the_same(name: str, text: str, tmp_path: Path) -> None:
    file = tmp_path / "robot.urdf"
    file.write_text(text, "utf-8")
    ours, theirs = read_urdf(text), yourdfpy.URDF.load(str(file), build_scene_graph=False, load_meshes=False).robot
    assert ours.problems == []
    assert list(ours.links) == [each.name for each in theirs.links]
    assert list(ours.joints) == [each.name for each in theirs.joints]
    masses = {each.name: each.inertial.mass for each in theirs.links if each.inertial is not None}
    assert {each.name: each.mass for each in ours.links.values() if each.mass is not None} == masses
    for joint, other in zip(ours.joints.values(), theirs.joints, strict=True):
        assert (joint.type, joint.parent, joint.child) == (other.type, other.parent, other.child)
        assert joint.mimics == (None if other.mimic is None else other.mimic.joint)
        assert np.allclose(matrix(joint), np.eye(4) if other.origin is None else other.origin)
        assert joint.axis is None or np.allclose(joint.axis, other.axis)
        stated = {} if other.limit is None else {each: value for each, value in vars(other.limit).items() if value}
        assert {each: value for each, value in joint.limits.items() if value} == stated
