"""Types of a real ROS 2 system: their hashes, and unknown types."""

from __future__ import annotations

import importlib
import json
import sys
from pathlib import Path
from typing import Any

import pytest

from rosld.adapters.model import MessageSchema, Primitive, TypeRef, library
from rosld.adapters.ros2 import types
from tests.adapters.ros2.conftest import opened

pytestmark = pytest.mark.slow

SHARE = Path(sys.prefix) / "share"


def test_every_type_installed_here_has_the_hash_that_came_with_it() -> None:
    known = library.TypeLibrary(ros_version=2, folders=types.definition_folders([], {}))
    wrong = {}
    checked = 0
    for path in SHARE.glob("*/*/*.json"):
        name = "/".join(path.with_suffix("").parts[-3:])
        stated = json.loads(path.read_text()).get("type_hashes", [])
        hashes = {each["type_name"]: each["hash_string"] for each in stated}
        definition = path.with_suffix(f".{path.parent.name}")
        if name in hashes and definition.exists() and "wstring" not in definition.read_text():
            for each, hash in hashes.items():  # the type itself, and the types that ROS 2 derives from it
                checked += 1
                found = known.find(TypeRef(each)).ref.hash
                if found != hash:
                    wrong[each] = found
    assert checked > 400
    assert not wrong


async def test_a_topic_whose_package_is_not_installed_here_is_listed_with_the_reason(
    lone_ros: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    lone_ros.node("odd.py", "foreign", "foreign")
    for name in ("visualization_msgs", "visualization_msgs.msg", "visualization_msgs.srv"):
        monkeypatch.setitem(sys.modules, name, None)
    async with opened(lone_ros) as session:
        topic = await session.until(lambda: session.graph.topics.get("/marker"))
        assert [each.name for each in topic.types] == ["visualization_msgs/msg/Marker"]
        assert topic.types[0].hash.startswith("RIHS01_")
        assert "visualization_msgs is not installed" in topic.unreadable
        service = await session.until(lambda: session.graph.services.get("/get_markers"))
        assert "visualization_msgs is not installed" in service.uncallable
        subscription = await session.adapter.subscribe("/marker")
        assert list(subscription.latest()) == []


@pytest.mark.parametrize("way", ["foreign", "idl"])
async def test_a_type_that_lies_nowhere_here_is_asked_of_the_node_that_uses_it_however_it_is_written(
    lone_ros: Any, monkeypatch: pytest.MonkeyPatch, way: str
) -> None:
    lone_ros.node("odd.py", way, way)
    monkeypatch.setattr(sys.modules["rosld.adapters.ros2.adapter"], "definition_folders", lambda given: [])
    monkeypatch.setattr(library, "stored_texts", lambda version: {})
    async with opened(lone_ros) as session:
        topic = await session.until(lambda: session.graph.topics.get("/marker"))
        schema = await session.schema(topic.types[0])
        assert schema.ref == topic.types[0]
        assert "pose" in {field.name for field in schema.type.fields}
        (sample,) = await session.first(await session.adapter.subscribe("/marker"))
        assert (await session.decoded(sample)).ns == ""
        nested = await session.schema(TypeRef("geometry_msgs/msg/Pose"))
        assert {field.name for field in nested.type.fields} == {"position", "orientation"}


def test_what_every_message_installed_here_is_made_with_are_the_defaults_of_its_type() -> None:
    known = library.TypeLibrary(ros_version=2, folders=types.definition_folders([], {}))
    checked = 0
    for path in sorted(SHARE.glob("*/msg/*.msg")):
        package, name = path.parent.parent.name, path.stem
        made = getattr(importlib.import_module(f"{package}.msg"), name)()
        schema = known.find(TypeRef(f"{package}/msg/{name}"))
        assert isinstance(schema, MessageSchema)
        for field in schema.type.fields:
            if isinstance(field.type, Primitive) and field.type.name != "byte":  # bytes in Python
                stated = field.default if field.default is not None else type(getattr(made, field.name))()
                assert getattr(made, field.name) == stated, f"{package}/{name}.{field.name}"
                checked += field.default is not None
    assert checked > 4
