"""Look-ups by tf2 itself, under Debian's Python: transforms and queries as JSON on stdin, answers on stdout."""

from __future__ import annotations

import json
import sys

import genpy
import tf2_py
from geometry_msgs.msg import TransformStamped


def seconds(stamp: int) -> genpy.Time:
    return genpy.Time(stamp // 1_000_000_000, stamp % 1_000_000_000)


def main() -> None:
    asked = json.load(sys.stdin)
    buffer = tf2_py.BufferCore(genpy.Duration(10))
    for parent, child, stamp, translation, rotation in asked["transforms"]:
        each = TransformStamped()
        each.header.frame_id, each.child_frame_id, each.header.stamp = parent, child, seconds(stamp)
        for part, axes, values in (
            (each.transform.translation, "xyz", translation),
            (each.transform.rotation, "xyzw", rotation),
        ):
            for axis, value in zip(axes, values, strict=True):
                setattr(part, axis, value)
        buffer.set_transform(each, "test")
    answers = []
    for target, source, stamp in asked["questions"]:
        try:
            found = buffer.lookup_transform_core(target, source, seconds(stamp)).transform
        except tf2_py.TransformException:
            answers.append(None)
            continue
        answers.append(
            [getattr(found.translation, axis) for axis in "xyz"] + [getattr(found.rotation, axis) for axis in "xyzw"]
        )
    json.dump(answers, sys.stdout)


main()
