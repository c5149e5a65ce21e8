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
    """The only message, decoded."""
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


@STORAGES
def test_a_service_event_topic_without_a_definition_is_read_from_the_services_that_rosld_knows(
    recorder: ModuleType, tmp_path: Path, opened: Opened, storage: str
) -> None:
    data = INFO + struct.pack("<IB3x", 1, 1) + struct.pack("<I", 0)
    hash = "RIHS01_3c4c20015afb4303eafd347b1d6a786f171a89c814726961a9593ef10df878cf"
    told = recorder.Hidden("/set/_service_event", "std_srvs/srv/SetBool_Event", "", data, hash)
    with opened(recorder.write_hidden(tmp_path / "run", [told], storage)) as bag:
        assert [each.data for each in only(bag).request] == [True]


@STORAGES
def test_the_feedback_of_an_action_is_read_from_the_actions_that_rosld_knows(
    recorder: ModuleType, tmp_path: Path, opened: Opened, storage: str
) -> None:
    data = ID + struct.pack("<d", 4.5)
    hash = "RIHS01_d18a3556a261de15d29e8ccd38eded71e72e111a0e2783639ac60888e1ac2db8"
    told = recorder.Hidden("/fly/_action/feedback", f"{FLY}_FeedbackMessage", "", data, hash)
    with opened(recorder.write_hidden(tmp_path / "run", [told], storage)) as bag:
        message = only(bag)
        assert (bytes(message.goal_id.uuid), message.feedback.flown) == (ID, 4.5)


@STORAGES
@pytest.mark.parametrize(
    ("topic", "end", "data", "found"),
    [
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
    ],
)
def test_an_action_is_read_from_the_definition_that_is_recorded_with_it(
    recorder: ModuleType, tmp_path: Path, opened: Opened, storage: str, topic: str, end: str, data: bytes, found: Any
) -> None:
    told = recorder.Hidden(f"/walk/_action/{topic}", f"my_msgs/action/Walk_{end}", WALK + POINT, data)
    with opened(recorder.write_hidden(tmp_path / "run", [told], storage)) as bag:
        assert found(only(bag))


@STORAGES
def test_the_status_of_an_action_is_read(recorder: ModuleType, tmp_path: Path, opened: Opened, storage: str) -> None:
    data = struct.pack("<I", 1) + ID + struct.pack("<iIb", 7, 8, 4)
    told = recorder.Hidden(
        "/fly/_action/status",
        "action_msgs/msg/GoalStatusArray",
        "",
        data,
        "RIHS01_6c1684b00f177d37438febe6e709fc4e2b0d4248dca4854946f9ed8b30cda83e",
    )
    with opened(recorder.write_hidden(tmp_path / "run", [told], storage)) as bag:
        (status,) = only(bag).status_list
        assert (bytes(status.goal_info.goal_id.uuid), status.status) == (ID, 4)


@STORAGES
def test_what_nobody_defines_is_listed_with_the_reason_and_hidden_from_listings(
    recorder: ModuleType, tmp_path: Path, play: Any, storage: str
) -> None:
    named = {
        "/odd/_action/feedback": ("odd/action/Odd_FeedbackMessage", "", "odd/action/Odd_Feedback"),
        "/odd/_service_event": ("odd/srv/Odd_Event", "", "odd/srv/Odd_Re"),
        "/torn/_action/feedback": ("odd/action/Torn_FeedbackMessage", "int8 a\n---\nint8 b\n", "two '---' lines"),
        "/other/_service_event": ("std_srvs/srv/SetBool_Event", "", "RIHS01_" + "0" * 64),
    }
    told = [recorder.Hidden(topic, type, text, b"") for topic, (type, text, _) in named.items()]

    async def scenario(adapter: Any) -> None:
        assert adapter.capabilities.hidden_names
        assert set(adapter.graph.topics) == set(named)
        for topic, (type, _, words) in named.items():
            known = adapter.graph.topics[topic]
            assert [each.name for each in known.types] == [type]
            assert words in known.unreadable

    play(recorder.write_hidden(tmp_path / "run", told, storage), scenario)


def test_a_recording_of_ros_1_hides_no_names(recorder: ModuleType, tmp_path: Path, play: Any) -> None:
    async def scenario(adapter: Any) -> None:
        assert not adapter.capabilities.hidden_names

    play(recorder.write_rosbag1(tmp_path / "run.bag", recorder.lines(count=1)), scenario)
