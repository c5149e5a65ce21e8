"""Look-ups of frames, compared to tf2 on random trees, and graphs that are no trees."""

from __future__ import annotations

import json
import random
import subprocess
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from rosld.adapters.model import Encoding, Sample, TypeRef
from rosld.server.space.transforms import FrameBuffer, NoTransform, Transform, apply

PYTHON = "/usr/bin/python3"
SECOND = 1_000_000_000
SAMPLE = Sample(b"", Encoding.ROS1, TypeRef("tf2_msgs/msg/TFMessage"), "/robot", 1, 1)
UPRIGHT = (0.0, 0.0, 0.0, 1.0)


def message(*transforms: tuple[str, str, int, Any, Any]) -> Any:
    """Return a tf2_msgs/TFMessage: parent, child, stamp, translation, rotation of each."""
    return SimpleNamespace(
        transforms=[
            SimpleNamespace(
                header=SimpleNamespace(frame_id=parent, stamp=SimpleNamespace(sec=at // SECOND, nanosec=at % SECOND)),
                child_frame_id=child,
                transform=SimpleNamespace(
                    translation=SimpleNamespace(**dict(zip("xyz", translation, strict=True))),
                    rotation=SimpleNamespace(**dict(zip("xyzw", rotation, strict=True))),
                ),
            )
            for parent, child, at, translation, rotation in transforms
        ]
    )


def buffer_of(*transforms: tuple[str, str, int, Any, Any]) -> FrameBuffer:
    buffer = FrameBuffer()
    for each in transforms:
        buffer.add(message(each), SAMPLE, is_static=False)
    return buffer


def trees(chance: random.Random) -> list[tuple[str, str, int, Any, Any]]:
    """Return two trees of twelve frames, each published at ten times within five seconds."""
    parents = {f"frame{each}": f"frame{chance.randrange(each)}" for each in range(1, 12)}
    parents |= {f"other{each}": f"other{chance.randrange(each)}" for each in range(1, 12)}
    said = []
    for child, parent in parents.items():
        usual = [chance.gauss(0, 1) for _ in range(4)]
        spread = chance.choice((1e-4, 0.1, 1))
        for at in range(10):
            stamp = 1000 * SECOND + at * SECOND // 2 + chance.randrange(1000)
            translation = tuple(chance.uniform(-10, 10) for _ in range(3))
            rotation = tuple(chance.gauss(each, spread) for each in usual)
            length = sum(each * each for each in rotation) ** 0.5
            said.append((parent, child, stamp, translation, tuple(each / length for each in rotation)))
    return said


@pytest.mark.slow
def test_exact_look_ups_find_what_tf2_finds() -> None:
    if subprocess.run([PYTHON, "-c", "import tf2_py"], capture_output=True, check=False).returncode:
        pytest.skip("needs tf2: apt-get install $(cat tests/debian-ros.txt)")
    chance = random.Random(5)
    said = trees(chance)
    names = sorted({each for parent, child, *_ in said for each in (parent, child)})
    within = range(1000 * SECOND + SECOND // 2, 1004 * SECOND, 1000)
    around = range(999 * SECOND, 1006 * SECOND, 1000)
    questions = [
        (
            chance.choice(names),
            chance.choice(names),
            0 if number % 9 == 0 else chance.choice((within, around)[number % 2]),
        )
        for number in range(1500)
    ]
    script = Path(__file__).with_name("tf2_buffer.py")
    asked = json.dumps({"transforms": said, "questions": questions})
    answers = json.loads(
        subprocess.run([PYTHON, script], input=asked, capture_output=True, text=True, check=True).stdout
    )
    buffer = buffer_of(*chance.sample(said, len(said)))
    exact = FrameBuffer.of(buffer.rows())
    assert 200 < sum(each is None for each in answers) < 1300
    for (target, source, stamp), answer in zip(questions, answers, strict=True):
        if answer is None:
            with pytest.raises(NoTransform, match="no path"):
                exact.look_up(target, source, stamp or None)
            continue
        judge, own = Transform(tuple(answer[:3]), tuple(answer[3:])), exact.look_up(target, source, stamp or None)
        for point in ((0.0, 0.0, 0.0), (1.0, -2.0, 3.0)):
            assert apply(own, point) == pytest.approx(apply(judge, point), abs=1e-9)
        if stamp:
            assert buffer.look_up(target, source, stamp) == own


def test_beyond_what_was_said_the_nearest_stands() -> None:
    buffer = buffer_of(("map", "base", SECOND, (1, 0, 0), UPRIGHT), ("map", "base", 3 * SECOND, (3, 0, 0), UPRIGHT))
    assert [buffer.look_up("map", "/base", at).translation[0] for at in (0, 2 * SECOND, 9 * SECOND, None)] == [
        1,
        2,
        3,
        3,
    ]


def test_time_that_begins_anew_forgets_what_was_said_before() -> None:
    buffer = buffer_of(
        ("map", "base", 100 * SECOND, (1, 0, 0), UPRIGHT), ("map", "base", 5 * SECOND, (7, 0, 0), UPRIGHT)
    )
    assert buffer.look_up("map", "base", 100 * SECOND).translation == (7, 0, 0)


def test_what_is_no_tree_and_what_is_no_transform_is_said() -> None:
    nan = float("nan")
    buffer = buffer_of(
        ("map", "base", 1, (0, 0, 0), (0, 0, 0, nan)),
        ("map", "odom", 1, (nan, 0, 0), UPRIGHT),
        ("one", "two", 1, (1, 0, 0), UPRIGHT),
        ("two", "one", 1, (1, 0, 0), UPRIGHT),
        ("one", "arm", 1, (1, 0, 0), UPRIGHT),
        ("self", "self", 1, (0, 0, 0), UPRIGHT),
        ("map", "", 1, (0, 0, 0), UPRIGHT),
    )
    buffer.add(SimpleNamespace(transforms=[SimpleNamespace()]), SAMPLE, is_static=False)  # type: ignore[arg-type]
    assert "is not a rotation" in buffer.problems["base"]
    assert buffer.problems["odom"] == "nan is not a coordinate"
    assert "its own parent" in buffer.problems["self"]
    with pytest.raises(NoTransform, match=r"There is no frame called base: The quaternion \(0, 0, 0, nan\)"):
        buffer.look_up("arm", "base")
    with pytest.raises(NoTransform, match="names no frame"):
        buffer.look_up("arm", "")
    assert buffer.look_up("two", "arm").translation == (2, 0, 0)
    assert list(buffer.names) == ["arm", "one", "two"]
    assert buffer.roots
