"""Writes of properties: the outcome that the setter tells, and parameters that keep the type of the property."""

from __future__ import annotations

import pytest

from tests.server.robots.made_up import MadeUp, Serving


@pytest.mark.parametrize(("message", "words"), [("too <fast>", "too <fast>"), ("", None)])
def test_a_setter_that_refuses_is_told_with_the_robot_s_words(
    robot: MadeUp, serving: Serving, message: str, words: str | None
) -> None:
    robot.variable("/arm/grip", "Byte", value=1)
    robot.answer("/arm/set_grip", "made_up/srv/SetByte", success=False, message=message)
    refused = serving().put("/resources/arm/grip", json=2)
    assert refused.status_code == 422
    assert "/arm/set_grip" in refused.json()["detail"]
    assert refused.json().get("robotSaid") == words


def test_a_parameter_beside_something_typed_keeps_to_that_type(robot: MadeUp, serving: Serving) -> None:
    robot.topic("/arm/speed", "std_msgs/msg/Float64", {"data": 1.5})
    robot.parameter("/arm/speed", 1.5)
    robot.topic("/arm/point", "geometry_msgs/msg/Point", {"x": 1})
    robot.parameter("/arm/point", "here")
    http = serving()
    speed = "/parameters/arm/speed"
    for content, media_type, stored in (
        ("5", "application/json", "5.0"),
        ("<> <http://www.w3.org/1999/02/22-rdf-syntax-ns#value> 6 .", "text/turtle", "6.0"),
    ):
        answer = http.put("/resources/arm/speed", content=content, headers={"Content-Type": media_type})
        assert answer.status_code == 204, answer.text
        assert http.get(speed, headers={"Accept": "application/json"}).text.strip() == stored
    assert "float64" in http.put("/resources/arm/speed", json="fast").json()["detail"]
    (missing,) = http.put("/resources/arm/point", json={"x": 1, "y": 2}).json()["violations"]
    assert missing["path"] == "z"
