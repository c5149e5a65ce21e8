"""Name of a robot on its pages: the one that it states, else that of its machine; never an address."""

from __future__ import annotations

import re
import socket

import pytest

from rosld.adapters.model.parameter import ParameterValue
from rosld.server.robot.session import host_name, shown_name
from tests.server.robots.made_up import MadeUp, served
from tests.waiting import until

HTML = {"Accept": "text/html"}
URDF = '<?xml version="1.0"?><!-- made --><robot xmlns:xacro="x" name="turtle &amp; co"><link name="base"/></robot>'


@pytest.mark.slow
def test_a_robot_is_called_what_it_or_the_settings_say() -> None:
    named: tuple[tuple[dict[str, ParameterValue], dict[str, str], str], ...] = (
        ({"/robot_name": "Marvin", "/robot_description": URDF}, {}, "Marvin"),
        ({"/ns/robot_description": URDF}, {}, "turtle &amp; co"),
        ({"/robot_name": "Marvin"}, {"name": "Rosie"}, "Rosie"),
        ({"/robot_name": "<b>x</b>\x1b\n" + "y" * 500}, {}, "&lt;b&gt;x&lt;/b&gt; yyy"),
        ({"/robot_name": 5, "/robot_description": "<robot"}, {}, "made-up"),
    )
    for parameters, settings, shown in named:
        robot = MadeUp()
        for name, value in parameters.items():
            robot.parameter(name, value)
        with served(robot, **settings) as http:
            title = re.compile(r"<title>[^<]*" + re.escape(shown))
            until(lambda title=title, http=http: title.search(http.get("/", headers=HTML).text), shown)
            assert "y" * 61 not in http.get("/", headers=HTML).text


def test_a_machine_on_loopback_is_called_by_its_name_and_another_by_its_own() -> None:
    here = shown_name(socket.gethostname())
    assert {
        host_name(uri) for uri in ("http://127.0.0.1:11311", "http://localhost:11311/", "http://[::1]:1", None)
    } == {here}
    assert host_name("http://turtle-7.example:11311/") == "turtle-7.example"
