"""Numbers with a constant in the definition of their message are shown with its name."""

from __future__ import annotations

from rosld.adapters.model.library import TypeLibrary
from rosld.server.html.messages import constant_name, message_view
from rosld.server.html.view import TextView
from tests.server.html.messages import message, schema
from tests.server.html.test_pages import field

CONSTANTS = {
    "uint8 STATE_ON=1\nuint8 MODE_ON=1\nuint8 MODE_OFF=0\nuint8 state\nuint8 mode": {"state": "ON", "mode": "ON"},
    "uint8 PENDING=0\nuint8 ACTIVE=1\nint32 MOST=1\nuint8 status\nint32 count": {"status": "ACTIVE", "count": ""},
    "byte INFO=1\nbyte WARN=2\nbyte level\nuint32 line": {"level": "INFO", "line": ""},
    "int32 CUBE=1\nint32 ADD=0\nint32 type\nint32 action": {"type": "", "action": ""},
    "uint8 GOOD=1\nuint8 FINE=1\nuint8 state": {"state": ""},
    "float32 STATE_ON=1.0\nuint8 state": {"state": ""},
    "uint8 LIMIT=1\nuint8 count": {"count": ""},
    "string STATE_ON=1\nuint8 state": {"state": ""},
}


def test_a_constant_names_the_value_of_the_field_that_it_is_of() -> None:
    for text, words in CONSTANTS.items():
        kind = TypeLibrary(ros_version=1).learn_message("made_up/msg/Status", text).type
        assert {each.name: constant_name(kind, each, 1) for each in kind.fields} == words, text
        assert {constant_name(kind, each, 77) for each in kind.fields} == {""}, text


def test_a_battery_tells_in_words_what_its_numbers_mean() -> None:
    kind = schema("sensor_msgs/msg/BatteryState")
    view = message_view(kind, message(kind, {"power_supply_status": 2, "power_supply_health": 1}))
    assert field(view, "power_supply_status") == TextView("2", "DISCHARGING", tone="number")
    assert field(view, "power_supply_health") == TextView("1", "GOOD", tone="number")
