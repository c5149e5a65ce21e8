"""The embedded rover as a robot of the contract suite."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from rosld.adapters.base import AdapterOptions
from rosld.adapters.model import ActionSchema, MessageSchema, TypeRef
from rosld.adapters.model.library import TypeLibrary
from rosld.adapters.model.plain import message_of
from rosld.adapters.rover import rover_adapter
from rosld.adapters.rover.messages import pose_stamped
from rosld.adapters.rover.navigation import Pose
from tests.contracts.robot import Acted, Asked, Robot, Spoken

HAS = frozenset(["writable", "answering", "acting", "rejecting", "guarded"])

ACTION, ACTION_TYPE = "/navigate_to", "rosld_rover/action/NavigateTo"
TWIST = {"linear": {"x": 0.2, "y": 0.0, "z": 0.0}, "angular": {"x": 0.0, "y": 0.0, "z": 0.0}}


def parts(library: TypeLibrary, type: str, fields: Mapping[str, object]) -> Mapping[str, object]:
    """Return the fields of a message (for an action, its goal), with nested messages."""
    schema = library.find(TypeRef(type))
    if isinstance(schema, ActionSchema):
        schema = schema.goal
    assert isinstance(schema, MessageSchema)
    made = message_of(schema, fields)
    return {field.attribute: getattr(made, field.attribute) for field in schema.type.fields}


def goal(library: TypeLibrary, x: float, y: float, *, frame: str = "map") -> Mapping[str, object]:
    """Return the fields of a goal."""
    pose = pose_stamped(Pose(x, y, 0.0), 0)
    framed = {**pose, "header": {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": frame}}
    return parts(library, ACTION_TYPE, {"pose": framed})


@contextmanager
def robot(folder: Path) -> Iterator[object]:
    """Run a rover that never fails: it neither hangs nor vanishes, and is always there.

    Its time is slow, so that a goal lasts long enough on a busy machine; it starts at the target of the quick goal.
    """
    library = TypeLibrary(ros_version=2)
    yield Robot(
        name="rover",
        adapter=lambda: rover_adapter("rover:?rate=0.1", AdapterOptions()),
        nowhere=None,
        readable="/odom",
        writable=Spoken("/cmd_vel", "geometry_msgs/msg/Twist", parts(library, "geometry_msgs/msg/Twist", TWIST)),
        answering=Asked(
            "/set_lights", "std_srvs/srv/SetBool", {"data": True}, response={"message": "the lights are on"}
        ),
        acting=Acted(ACTION, ACTION_TYPE, quick=goal(library, 0.0, 0.0), lasting=goal(library, 4.5, -3.5)),
        rejecting=(ACTION, ACTION_TYPE, goal(library, 1.0, 0.0, frame="moon")),
        guarded=("/rover/drive_mode", "warp", "drive_mode is one of eco, normal, sport, not 'warp'"),
    )
