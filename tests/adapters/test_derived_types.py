"""Types that ROS 2 derives: what actions are sent by, and the messages in which services tell of their calls."""

from __future__ import annotations

from pathlib import Path

import pytest

from rosld.adapters.model import ActionSchema, Encoding, MessageSchema, ServiceSchema, TypeRef, UnknownType
from rosld.adapters.model.library import TypeLibrary

FLY = "rosld_aircraft/action/Fly"
HASHES = {
    f"{FLY}_FeedbackMessage": "d18a3556a261de15d29e8ccd38eded71e72e111a0e2783639ac60888e1ac2db8",
    f"{FLY}_SendGoal_Request": "f37b07c532f46ff9d99339e187247a7af5a90170f68df20abb5283c98e2bf661",
    f"{FLY}_SendGoal_Response": "5b33199b9de335324844a52d16e750707da311834db70ab831ade06cbfb830a0",
    f"{FLY}_GetResult_Request": "ab4141fe40eb4c4f0299a60e6e902473852ad1969cc4f3c07015f607e9358415",
    f"{FLY}_GetResult_Response": "a6b6c16144dbcfca39245f4d18b12c97c679550f4d7bfc13b26da3e1c15aab2d",
    "std_srvs/srv/Trigger_Request": "d010825374ce8918e72bfd826c82603e60f45419e932ea976f807b74a863a199",
    "std_srvs/srv/Trigger_Response": "2d946c21e2fc3f1e9ca6986a8191d85fcc70097a8bb7771a053564bc47009cdf",
}
"""As the endpoints of a node of Jazzy tell them."""


@pytest.fixture(scope="module")
def library() -> TypeLibrary:
    return TypeLibrary(ros_version=2)


@pytest.mark.parametrize("name", HASHES)
def test_a_derived_type_has_the_hash_that_ros_2_gives_it(library: TypeLibrary, name: str) -> None:
    wanted = TypeRef(name, f"RIHS01_{HASHES[name]}")
    assert library.find(wanted).ref == wanted


@pytest.mark.parametrize(
    ("name", "kind"),
    [
        (FLY, ActionSchema),
        (f"{FLY}_SendGoal", ServiceSchema),
        (f"{FLY}_GetResult", ServiceSchema),
        (f"{FLY}_GetResult_Event", MessageSchema),
        (f"{FLY}_Result", MessageSchema),
        ("action_msgs/srv/CancelGoal", ServiceSchema),
        ("action_msgs/srv/CancelGoal_Event", MessageSchema),
    ],
)
def test_what_is_derived_is_a_message_or_a_service(library: TypeLibrary, name: str, kind: type) -> None:
    assert type(library.find(TypeRef(name))) is kind


def test_a_part_of_an_action_has_its_own_name_where_it_is_nested(library: TypeLibrary) -> None:
    schema = library.find(TypeRef(f"{FLY}_FeedbackMessage"))
    assert isinstance(schema, MessageSchema)
    assert set(schema.types) == {schema.ref.name, f"{FLY}_Feedback", "unique_identifier_msgs/msg/UUID"}
    assert f"MSG: {FLY}_Feedback\n" in schema.definition
    data = b"\0\1\0\0" + bytes(range(16)) + b"\0\0\0\0\0\0\x12\x40"
    message = schema.codec.decode(data, Encoding.CDR)
    assert (bytes(message.goal_id.uuid), message.feedback.flown) == (bytes(range(16)), 4.5)  # type: ignore[attr-defined]
    assert schema.codec.encode(message, Encoding.CDR) == data


@pytest.mark.parametrize("name", ["odd/action/Walk_FeedbackMessage", "odd/srv/Ask_Event", "odd/action/Walk_SendGoal"])
def test_what_is_derived_of_an_unknown_type_is_unknown_and_says_what_lacks(library: TypeLibrary, name: str) -> None:
    with pytest.raises(UnknownType, match=r"needs odd/(action/Walk|srv/Ask)_"):
        library.find(TypeRef(name))


def test_ros_1_derives_nothing(tmp_path: Path) -> None:
    folder = tmp_path / "diary" / "srv"
    folder.mkdir(parents=True)
    (folder / "New_Event.srv").write_text("string what\n---\n")
    assert isinstance(TypeLibrary(ros_version=1, folders=[folder]).find(TypeRef("diary/srv/New_Event")), ServiceSchema)
    with pytest.raises(UnknownType):
        TypeLibrary(ros_version=1).find(TypeRef("std_srvs/srv/Trigger_Event"))
