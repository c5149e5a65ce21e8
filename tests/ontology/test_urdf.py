"""Robot descriptions in URDF, sound ones and such as an enemy or a mistake would make."""

from __future__ import annotations

import time

import pytest

from rosld.ontology.urdf import MAX_CHARACTERS, Joint, Link, MountedSensor, UnreadableUrdf, read_urdf

ARM = """<?xml version="1.0" encoding="latin-1"?>
<robot name="arm" xmlns:xacro="http://www.ros.org/wiki/xacro">
  <material name="grey"><color rgba="0.5 0.5 0.5 1"/></material>
  <link name="base"><inertial><mass value="2.5"/></inertial></link>
  <link name="upper"/> <link name="lower"/> <link name="hand"/>
  <joint name="shoulder" type="revolute">
    <parent link="base"/> <child link="upper"/> <origin xyz="0 0 0.1" rpy="0 1.5 0"/> <axis xyz="0 0 1"/>
    <limit lower="-1.5" upper="2" effort="30" velocity="1e0"/>
  </joint>
  <joint name="slide" type="prismatic">
    <parent link="upper"/> <child link="lower"/> <limit upper="0.4" effort="5" velocity="0.1"/>
    <mimic joint="shoulder"/>
  </joint>
  <joint name="wrist" type="fixed"> <parent link="lower"/> <child link="hand"/> </joint>
  <sensor name="force" type="force_torque"><parent link="hand"/></sensor>
  <gazebo reference="hand"><sensor name="eye" type="camera"/></gazebo>
  <gazebo><plugin name="control"/></gazebo>
</robot>"""


def test_links_joints_and_sensors_are_read() -> None:
    arm = read_urdf(ARM)
    assert (arm.name, arm.problems, arm.roots) == ("arm", [], ["base"])
    assert list(arm.links.values()) == [Link("base", 2.5), Link("upper"), Link("lower"), Link("hand")]
    z, x = (0.0, 0.0, 1.0), (1.0, 0.0, 0.0)
    turning = {"lower": -1.5, "upper": 2.0, "velocity": 1.0, "effort": 30.0}
    shoulder = Joint("shoulder", "revolute", "base", "upper", (0, 0, 0.1), (0, 1.5, 0), z, turning)
    limits = {"lower": 0.0, "upper": 0.4, "velocity": 0.1, "effort": 5.0}
    slide = Joint("slide", "prismatic", "upper", "lower", axis=x, limits=limits, mimics="shoulder")
    assert list(arm.joints.values()) == [shoulder, slide, Joint("wrist", "fixed", "lower", "hand")]
    assert list(arm.sensors.values()) == [
        MountedSensor("force", "force_torque", "hand"), MountedSensor("eye", "camera", "hand")
    ]  # fmt: skip


LAUGHS = "".join(f'<!ENTITY l{n} "{f"&l{n - 1};" * 10}">' for n in range(1, 20))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "not well-formed XML"),
        ("<robot", "not well-formed XML"),
        ("<robot name='\x00'/>", "not well-formed XML"),
        ("<robot name='\ud800'/>", "not well-formed XML"),
        ("<robot>&amp;&lol;</robot>", "not well-formed XML"),
        ("<sdf version='1.6'/>", "the element 'sdf', not robot"),
        (f'<!DOCTYPE robot [<!ENTITY l0 "ha">{LAUGHS}]><robot name="&l19;"/>', "document type declaration"),
        ('<!DOCTYPE r [<!ENTITY x SYSTEM "file:///etc/passwd">]><robot name="&x;"/>', "document type declaration"),
        (f"<robot>{' ' * MAX_CHARACTERS}</robot>", "more than 4,194,304"),
        (f"<robot>{'<link/>' * 10_001}</robot>", "more than 10,000 links"),
    ],
)
def test_a_text_that_is_no_description_is_refused_at_once(text: str, words: str) -> None:
    began = time.monotonic()
    with pytest.raises(UnreadableUrdf, match=words):
        read_urdf(text)
    assert time.monotonic() - began < 2


TWO = '<link name="a"/><link name="b"/>'
ENDS = '<parent link="a"/><child link="b"/>'


@pytest.mark.parametrize(
    ("parts", "words"),
    [
        ("<link/>", "A link has no name."),
        ('<link name="a"/>', "There are several links 'a': only the first counts."),
        (f'<joint type="fixed">{ENDS}</joint>', "A joint has no name."),
        (f'<joint name="j" type="ball">{ENDS}</joint>', "The joint 'j' has the unknown type 'ball'."),
        ('<joint name="j" type="fixed"><child link="b"/></joint>', "connects the link '', which is not described"),
        ('<joint name="j" type="fixed"><parent link="c"/></joint>', "connects the link 'c', which is not described"),
        (
            f'<joint name="j" type="revolute">{ENDS}<limit lower="NaN" upper="1e999"/></joint>',
            "The joint 'j' has the lower 'NaN', which is not a finite number.",
        ),
        (f'<joint name="j" type="planar">{ENDS}<axis xyz="0 1"/></joint>', "which is not three finite numbers"),
        (f'<joint name="j" type="fixed">{ENDS}<mimic joint="k"/></joint>', "mimics the joint 'k'"),
        ('<link name="c"><inertial><mass value="heavy"/></inertial></link>', "the value 'heavy'"),
        ('<gazebo reference="z"><sensor name="s"/></gazebo>', "The sensor 's' is on the link 'z'"),
        (f'<joint name="j" type="fixed">{ENDS}</joint><joint name="k" type="fixed">{ENDS}</joint>', "several joints"),
        ('<joint name="j" type="fixed"><parent link="a"/><child link="a"/></joint>', "is below itself"),
        (
            f'<joint name="j" type="fixed">{ENDS}</joint>'
            '<joint name="k" type="fixed"><parent link="b"/><child link="a"/></joint>',
            "is below itself: the links are no tree",
        ),
    ],
)
def test_what_is_wrong_with_a_part_is_said_and_the_rest_is_read(parts: str, words: str) -> None:
    robot = read_urdf(f"<robot>{TWO}{parts}</robot>")
    assert any(words in each for each in robot.problems), robot.problems
    assert {"a", "b"} <= robot.links.keys()


@pytest.mark.slow
def test_deep_nesting_long_chains_and_many_problems_do_not_harm() -> None:
    deep = read_urdf(f"<robot>{'<x>' * 200_000}{'</x>' * 200_000}<link name='a'/></robot>")
    assert list(deep.links) == ["a"]
    chain = "".join(
        f'<link name="l{n}"/><joint name="j{n}" type="fixed"><parent link="l{n}"/><child link="l{n + 1}"/></joint>'
        for n in range(4_000)
    )
    robot = read_urdf(f'<robot>{chain}<link name="l4000"/></robot>')
    assert (robot.roots, len(robot.joints), robot.problems) == (["l0"], 4_000, [])
    assert len(read_urdf(f"<robot>{'<link/>' * 5_000}</robot>").problems) == 21
