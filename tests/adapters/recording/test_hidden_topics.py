"""Hidden topics of services and actions in recordings of ROS 2: decoded, or listed with the reason why not."""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

STORAGES = pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
ADD = "int64 a\nint64 b\n---\nint64 sum\n"
WALK = "geometry_msgs/Point to\n---\nstring end\n---\nfloat64 walked\n"
POINT = f"{'=' * 80}\nMSG: geometry_msgs/Point\nfloat64 x\nfloat64 y\nfloat64 z\n"
INFO = struct.pack("<BxxxiI16sxxxxq", 1, 5, 6, b"g" * 16, 9)
ID = bytes(range(16))
FLY = "rosld_aircraft/action/Fly"

Opened = Callable[[Path], Any]


def only(bag: Any) -> Any:
    """Return the only message, decoded."""
    (topic,) = bag.topics.values()
    assert topic.unreadable is None
    sample = bag.message(0).sample
    return bag.schema(sample.schema).codec.decode(sample.data, sample.encoding)


@STORAGES
def test_a_service_event_topic_is_read_from_its_services_definition(
    recorder: ModuleType, tmp_path: Path, opened: Opened, storage: str
) -> None:
    data = INFO + struct.pack("<Ixxxxqq", 1, 20, 22) + struct.pack("<I", 0)
    told = recorder.Hidden("/add/_service_event", "example_interfaces/srv/AddTwoInts_Event", ADD, data)
    with opened(recorder.write_hidden(tmp_path / "run", [told], storage)) as bag:
        event = only(bag)
        assert (event.info.event_type, event.info.sequence_number) == (1, 9)
        assert [(each.a, each.b) for each in event.request] == [(20, 22)]
        assert event.response == []
        schema = bag.schema(bag.message(0).sample.schema)
        assert "example_interfaces/srv/AddTwoInts_Request" in schema.types


def test_hidden_topics_without_a_definition_are_read_from_the_types_that_rosld_knows(
    recorder: ModuleType, tmp_path: Path, opened: Opened
) -> None:
    recorded = (
        (
            recorder.Hidden(
                "/set/_service_event",
                "std_srvs/srv/SetBool_Event",
                "",
                INFO + struct.pack("<IB3x", 1, 1) + struct.pack("<I", 0),
                "RIHS01_3c4c20015afb4303eafd347b1d6a786f171a89c814726961a9593ef10df878cf",
            ),
            lambda it: [each.data for each in it.request] == [True],
        ),
        (
            recorder.Hidden(
                "/fly/_action/feedback",
                f"{FLY}_FeedbackMessage",
                "",
                ID + struct.pack("<d", 4.5),
                "RIHS01_d18a3556a261de15d29e8ccd38eded71e72e111a0e2783639ac60888e1ac2db8",
            ),
            lambda it: (bytes(it.goal_id.uuid), it.feedback.flown) == (ID, 4.5),
        ),
        (
            recorder.Hidden(
                "/fly/_action/status",
                "action_msgs/msg/GoalStatusArray",
                "",
                struct.pack("<I", 1) + ID + struct.pack("<iIb", 7, 8, 4),
                "RIHS01_6c1684b00f177d37438febe6e709fc4e2b0d4248dca4854946f9ed8b30cda83e",
            ),
            lambda it: [(bytes(one.goal_info.goal_id.uuid), one.status) for one in it.status_list] == [(ID, 4)],
        ),
    )
    for number, (told, fits) in enumerate(recorded):
        with opened(recorder.write_hidden(tmp_path / str(number), [told])) as bag:
            assert fits(only(bag)), told.topic


def test_an_action_is_read_from_the_definition_that_is_recorded_with_it(
    recorder: ModuleType, tmp_path: Path, opened: Opened
) -> None:
    recorded: tuple[tuple[str, str, bytes, Callable[[Any], bool]], ...] = (
        ("feedback", "FeedbackMessage", ID + struct.pack("<d", 2.5), lambda it: it.feedback.walked == 2.5),
        (
            "send_goal/_service_event",
            "SendGoal_Event",
            INFO + struct.pack("<I", 1) + ID + struct.pack("<4xddd", 1, 2, 3) + struct.pack("<I", 0),
            lambda it: it.request[0].goal.to.z == 3.0,
        ),
        (
            "get_result/_service_event",
            "GetResult_Event",
            INFO + struct.pack("<I", 0) + struct.pack("<IB3xI", 1, 4, 5) + b"home\0",
            lambda it: (it.response[0].status, it.response[0].result.end) == (4, "home"),
        ),
    )
    for topic, end, data, fits in recorded:
        told = recorder.Hidden(f"/walk/_action/{topic}", f"my_msgs/action/Walk_{end}", WALK + POINT, data)
        with opened(recorder.write_hidden(tmp_path / end, [told])) as bag:
            assert fits(only(bag)), topic


async def test_what_nobody_defines_is_listed_with_the_reason_and_hidden_from_listings(
    recorder: ModuleType, tmp_path: Path, play: Any
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


async def test_a_recording_of_ros_1_hides_no_names(recorder: ModuleType, tmp_path: Path, play: Any) -> None:
    async with play(recorder.write_rosbag1(tmp_path / "run.bag", recorder.lines(count=1))) as adapter:
        assert not adapter.capabilities.hidden_names
