"""ROS 2 on zenoh: what is special about it; the contract suite tests the rest."""

from __future__ import annotations

import pytest

from rosld.adapters.base import AdapterOptions
from rosld.adapters.model import Encoding, Qos, TypeRef
from rosld.adapters.ros2.zenoh_adapter import adapter
from rosld.adapters.ros2.zenoh_keys import (
    PUBLISHER,
    Attachment,
    Token,
    data_key,
    parse_token,
    qos_key,
    qos_of,
    read_attachment,
    token_key,
    write_attachment,
)
from tests.adapters.ros1.system import free_port
from tests.adapters.session import opened_on
from tests.adapters.zenoh.robot import Robot

HASH = "RIHS01_" + "ab" * 32
SESSION = "aac3178e146ba6f1fc6e6a4085e77f21"
KEY = f"@ros2_lv/2/{SESSION}/0/10/MP/%/%robot1/talker/%chatter/std_msgs::msg::dds_::String_/{HASH}"
"""As in rmw_zenoh's design document, with a namespace, and the default profile but for the depth."""


def test_tokens_say_what_an_entity_is() -> None:
    token = parse_token(f"{KEY}/::,7:,:,:,,")
    assert token == Token(
        PUBLISHER,
        "/robot1/talker",
        "/chatter",
        TypeRef("std_msgs/msg/String", HASH),
        Qos("reliable", "volatile", "keep_last", 7, liveliness="automatic"),
    )
    assert token_key(token, 2, SESSION, 0, 10) == f"{KEY}/::,7:,:,:,,"
    assert data_key(2, "/chatter", "std_msgs/msg/String", HASH) == f"2/chatter/std_msgs::msg::dds_::String_/{HASH}"
    for other in ("", "a/b", "@ros2_lv/0/x", KEY):
        assert parse_token(other) is None


def test_profiles_are_read_and_written() -> None:
    latched = Qos("best_effort", "transient_local", "keep_all", 42, 10**9, 5, "manual_by_topic", 3 * 10**9 + 7)
    assert qos_key(latched) == "2:1:2,:1,0:0,5:3,3,7"
    assert qos_of(qos_key(latched)) == latched
    assert qos_of("9:9:9,x:,:,:9,,").reliability is None
    assert qos_of("") == qos_of("::,:,:,:,,") == Qos("reliable", "volatile", "keep_last", 42, liveliness="automatic")


def test_attachments_have_the_length_of_the_id() -> None:
    attachment = Attachment(3, 10**18, bytes(range(16)))
    assert read_attachment(write_attachment(attachment)) == attachment
    assert write_attachment(attachment)[16] == 16
    assert read_attachment(b"short") is None


@pytest.mark.slow
async def test_latched_messages_are_received_and_messages_arrive_with_their_attachment() -> None:
    robot = Robot(free_port())
    robot.start()
    try:
        async with opened_on(adapter(robot.source, AdapterOptions()), seconds=20) as session:
            [sample] = await session.first(await session.adapter.subscribe("/description"))
            assert (sample.publisher, sample.latched) == ("/counter", True)
            assert b"a robot" in sample.data
            schema = await session.schema(TypeRef("std_msgs/msg/String"))
            data = schema.codec.encode(schema.codec.build(schema.ref.name, {"data": "hello"}), Encoding.CDR)
            assert (await session.publish("/cockpit/display", schema.ref, data, seconds=20)).matched == 1
            await session.until(lambda: robot.received)
            assert robot.received == [data]
    finally:
        robot.stop()


@pytest.mark.parametrize("source", ["zenoh://h:x", "zenoh://h/p", "zenoh:?domain=233", "zenoh:?x=1", "zenoh:?domain=a"])
def test_a_source_that_names_no_router_is_refused(source: str) -> None:
    with pytest.raises(ValueError, match="write zenoh://HOST:7447"):
        adapter(source, AdapterOptions())
