"""Hidden topics of services and actions in recordings of ROS 2: decoded, or listed with the reason why not."""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

from tests.adapters.recording import recorder
from tests.adapters.recording.recorder import opened

ADD = "int64 a\nint64 b\n---\nint64 sum\n"
WALK = "geometry_msgs/Point to\n---\nstring end\n---\nfloat64 walked\n"
POINT = f"{'=' * 80}\nMSG: geometry_msgs/Point\nfloat64 x\nfloat64 y\nfloat64 z\n"
INFO = struct.pack("<BxxxiI16sxxxxq", 1, 5, 6, b"g" * 16, 9)
ID = bytes(range(16))
FLY = "rosld_aircraft/action/Fly"


def only(bag: Any) -> Any:
    """Return the only message, decoded."""
    (topic,) = bag.topics.values()
    assert topic.unreadable is None
    sample = bag.message(0).sample
    return bag.schema(sample.schema).codec.decode(sample.data, sample.encoding)


ADDED = INFO + struct.pack("<Ixxxxqq", 1, 20, 22) + struct.pack("<I", 0)
HIDDEN: tuple[tuple[str, str, str, str, bytes, Callable[[Any], bool]], ...] = (
    (
        "/add/_service_event",
        "example_interfaces/srv/AddTwoInts_Event",
        ADD,
        "",
        ADDED,
        lambda it: (it.info.sequence_number, [(each.a, each.b) for each in it.request]) == (9, [(20, 22)]),
    ),
    (
        "/walk/_action/feedback",
        "my_msgs/action/Walk_FeedbackMessage",
        WALK + POINT,
        "",
        ID + struct.pack("<d", 2.5),
        lambda it: it.feedback.walked == 2.5,
    ),
    (
        "/walk/_action/send_goal/_service_event",
        "my_msgs/action/Walk_SendGoal_Event",
        WALK + POINT,
        "",
        INFO + struct.pack("<I", 1) + ID + struct.pack("<4xddd", 1, 2, 3) + struct.pack("<I", 0),
        lambda it: it.request[0].goal.to.z == 3.0,
    ),
    (
        "/walk/_action/get_result/_service_event",
        "my_msgs/action/Walk_GetResult_Event",
        WALK + POINT,
        "",
        INFO + struct.pack("<I", 0) + struct.pack("<IB3xI", 1, 4, 5) + b"home\0",
        lambda it: (it.response[0].status, it.response[0].result.end) == (4, "home"),
    ),
    (
        "/set/_service_event",
        "std_srvs/srv/SetBool_Event",
        "",
        "RIHS01_3c4c20015afb4303eafd347b1d6a786f171a89c814726961a9593ef10df878cf",
        INFO + struct.pack("<IB3x", 1, 1) + struct.pack("<I", 0),
        lambda it: [each.data for each in it.request] == [True],
    ),
    (
        "/fly/_action/feedback",
        f"{FLY}_FeedbackMessage",
        "",
        "RIHS01_d18a3556a261de15d29e8ccd38eded71e72e111a0e2783639ac60888e1ac2db8",
        ID + struct.pack("<d", 4.5),
        lambda it: (bytes(it.goal_id.uuid), it.feedback.flown) == (ID, 4.5),
    ),
    (
        "/fly/_action/status",
        "action_msgs/msg/GoalStatusArray",
        "",
        "RIHS01_6c1684b00f177d37438febe6e709fc4e2b0d4248dca4854946f9ed8b30cda83e",
        struct.pack("<I", 1) + ID + struct.pack("<iIb", 7, 8, 4),
        lambda it: [(bytes(one.goal_info.goal_id.uuid), one.status) for one in it.status_list] == [(ID, 4)],
    ),
)
"""Topics with their types, the recorded definitions (if any), the hashes that rosld knows, messages, and checks."""


def test_hidden_topics_are_read_from_what_is_recorded_with_them_or_from_the_types_that_rosld_knows(
    tmp_path: Path,
) -> None:
    for number, (topic, type, definition, hash, data, fits) in enumerate(HIDDEN):
        recorded = recorder.Hidden(topic, type, definition, data, *filter(None, [hash]))
        storage = ("mcap", "sqlite3")[number % 2]
        with opened(recorder.write_hidden(tmp_path / str(number), [recorded], storage)) as bag:
            assert fits(only(bag)), topic


async def test_what_nobody_defines_is_listed_with_the_reason_and_hidden_from_listings(
    tmp_path: Path, play: Any
) -> None:
    named = {
        "/odd/_action/feedback": ("odd/action/Odd_FeedbackMessage", "", "odd/action/Odd_Feedback"),
        "/odd/_service_event": ("odd/srv/Odd_Event", "", "odd/srv/Odd_Re"),
        "/torn/_action/feedback": ("odd/action/Torn_FeedbackMessage", "int8 a\n---\nint8 b\n", "two '---' lines"),
        "/other/_service_event": ("std_srvs/srv/SetBool_Event", "", "RIHS01_" + "0" * 64),
    }
    told = [recorder.Hidden(topic, type, text, b"") for topic, (type, text, _) in named.items()]
    async with play(recorder.write_hidden(tmp_path / "run", told)) as adapter:
        assert adapter.capabilities.hidden_names
        assert set(adapter.graph.topics) == set(named)
        for topic, (type, _, words) in named.items():
            known = adapter.graph.topics[topic]
            assert [each.name for each in known.types] == [type]
            assert words in known.unreadable


async def test_a_recording_of_ros_1_hides_no_names(tmp_path: Path, play: Any) -> None:
    async with play(recorder.write_rosbag1(tmp_path / "run.bag", recorder.lines(count=1))) as adapter:
        assert not adapter.capabilities.hidden_names
