"""Units: what the fields of common types measure, conventions of names, conversion, and symbols."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pyoxigraph import NamedNode
from rosbags.typesys import Stores, get_typestore

from rosld.adapters.model import Array, MessageSchema, Primitive, TypeRef
from rosld.adapters.model.library import SHIPPED, TypeLibrary
from rosld.ontology.modules import module_triples
from rosld.ontology.units import (
    _BY_SUFFIX,
    _BY_WORD,
    KIND,
    UNIT,
    Quantity,
    _factors,
    convert,
    quantity_at,
    quantity_of,
    symbol_of,
    unit_symbols,
)
from rosld.ontology.vocab import qudt, rdfs, ros

PACKAGES = (
    "std_msgs/", "geometry_msgs/", "sensor_msgs/", "nav_msgs/", "control_msgs/", "diagnostic_msgs/", "tf2_msgs/",
    "stereo_msgs/", "shape_msgs/", "trajectory_msgs/",
)  # fmt: skip
STORES = (Stores.ROS1_NOETIC, Stores.ROS2_HUMBLE, Stores.ROS2_JAZZY, Stores.ROS2_KILTED)
NO_NUMBERS = ("string", "wstring", "bool")
TYPES = "https://w3id.org/rosld/types/"


def numbers() -> Iterator[tuple[str, str]]:
    """Yield type and field of the packages' numbers, in ROS 1 and three ROS 2, as rosbags and rosld have them."""
    for store in STORES:
        for name, (_, fields) in get_typestore(store).fielddefs.items():
            for field, (kind, detail) in fields:
                base = detail[0] if kind.name in ("ARRAY", "SEQUENCE") else (kind, detail)
                if name.startswith(PACKAGES) and base[0].name == "BASE" and base[1][0] not in NO_NUMBERS:
                    yield name, field
    library = TypeLibrary(ros_version=1)
    for path in SHIPPED.rglob("*.msg"):
        name = f"{path.parts[-3]}/msg/{path.stem}"
        if name.startswith(PACKAGES):
            found = library.find(TypeRef(name))
            assert isinstance(found, MessageSchema)
            for each in found.type.fields:
                element = each.type.element if isinstance(each.type, Array) else each.type
                if isinstance(element, Primitive) and element.name not in NO_NUMBERS:
                    yield name, each.name


@pytest.mark.slow
def test_no_number_of_the_common_packages_is_left_out() -> None:
    every = set(numbers())
    triples = module_triples("units")
    stated = {each.subject.value.removeprefix(TYPES) for each in triples if each.object == ros.Field}
    assert sorted({f"{name}#{field}" for name, field in every} - stated) == []
    assert len(every) > 200


def test_a_field_has_a_unit_with_its_kind_of_quantity_or_is_said_to_have_none_and_why() -> None:
    found: dict[NamedNode, dict[NamedNode, Any]] = {}
    for subject, predicate, value in module_triples("units"):
        if subject.value.startswith(TYPES):
            found.setdefault(subject, {})[predicate] = value
    for about in found.values():
        has_unit = {qudt.hasUnit, qudt.hasQuantityKind} <= about.keys()
        assert has_unit != (ros.unitUnknown in about), about
        assert about[rdfs.comment].value.endswith("."), about


@pytest.mark.parametrize(
    ("type_name", "field", "unit", "kind"),
    [
        ("sensor_msgs/msg/BatteryState", "voltage", "V", "Voltage"),
        ("sensor_msgs/msg/Imu", "angular_velocity", "RAD-PER-SEC", "AngularVelocity"),
        ("geometry_msgs/msg/Twist", "linear", "M-PER-SEC", "LinearVelocity"),
        ("acme_msgs/msg/Depth", "depth_mm", "MilliM", "Length"),
        ("acme_msgs/msg/Motor", "rate_deg_s", "DEG-PER-SEC", "AngularVelocity"),
        ("acme_msgs/msg/Motor", "case_temperature_fahrenheit", "DEG_F", "Temperature"),
        ("acme_msgs/msg/Motor", "temperature", "DEG_C", "Temperature"),
        ("acme_msgs/msg/Motor", "Voltage", "V", "Voltage"),
    ],
)
def test_a_unit_is_found_by_definition_and_by_name(type_name: str, field: str, unit: str, kind: str) -> None:
    assert quantity_of(type_name, field) == Quantity(UNIT + unit, KIND + kind)


@pytest.mark.parametrize("field", ["speed", "m", "_m", "rpm", "w", "data", "items", "temperatures_", ""])
def test_a_name_that_says_no_unit_has_none(field: str) -> None:
    assert quantity_of("acme_msgs/msg/Motor", field) is None


@pytest.mark.parametrize(
    ("name", "path", "unit"),
    [
        ("nav_msgs/msg/Odometry", "twist.twist.linear.x", "M-PER-SEC"),
        ("nav_msgs/msg/Odometry", "pose.pose.orientation.w", "UNITLESS"),
        ("tf2_msgs/msg/TFMessage", "transforms.0.transform.translation.z", "M"),
        ("sensor_msgs/msg/MultiEchoLaserScan", "ranges.3.echoes.0", "M"),
        ("sensor_msgs/msg/MagneticField", "magnetic_field.y", "T"),
        ("sensor_msgs/msg/Imu", "header.frame_id", None),
        ("geometry_msgs/msg/Vector3", "x", None),
        ("trajectory_msgs/msg/MultiDOFJointTrajectoryPoint", "accelerations.0.linear.x", None),
        ("trajectory_msgs/msg/MultiDOFJointTrajectoryPoint", "velocities.0.linear.x", "M-PER-SEC"),
        ("std_msgs/msg/Float64", "data", None),
        ("std_msgs/msg/Float64", "none", None),
    ],
)
def test_the_unit_of_a_number_is_that_of_the_innermost_field_that_has_one(
    name: str, path: str, unit: str | None
) -> None:
    schema = TypeLibrary(ros_version=1).find(TypeRef(name))
    assert quantity_at(schema, path).unit == (None if unit is None else UNIT + unit)


def test_the_units_of_a_message_are_named_by_path() -> None:
    library = TypeLibrary(ros_version=1)
    symbols = unit_symbols(library.find(TypeRef("geometry_msgs/msg/TwistStamped")), 9)
    assert symbols == {"twist.linear": "m/s", "twist.angular": "rad/s"}
    assert len(unit_symbols(library.find(TypeRef("sensor_msgs/msg/LaserScan")), 4)) == 4


@pytest.mark.parametrize(
    ("value", "source", "target", "expected"),
    [
        (100, "KiloM-PER-HR", "M-PER-SEC", 250 / 9),
        (1, "M", "CentiM", 100.0),
        (20.5, "DEG_C", "K", 293.65),
        (98.6, "DEG_F", "DEG_C", 37.0),
        (180, "DEG", "RAD", math.pi),
        (math.pi, "RAD-PER-SEC", "REV-PER-MIN", 30.0),
        (0.25, "FRACTION", "PERCENT", 25.0),
        (2.2, "A-HR", "MilliA-HR", 2200.0),
        (8, "BIT", "BYTE", 1.0),
        (3, "FURLONG", "FURLONG", 3.0),
        (1, "N-M", "J", None),
        (1, "RAD", "UNITLESS", None),
        (1, "M", "SEC", None),
        (1, "M", "FURLONG-PER-FORTNIGHT", None),
    ],
)
def test_a_value_is_converted_into_units_of_the_same_kind(
    value: float, source: str, target: str, expected: float | None
) -> None:
    found = convert(value, UNIT + source, UNIT + target)
    assert found == (None if expected is None else pytest.approx(expected, rel=1e-14))


@given(st.floats(-1e300, 1e300), st.sampled_from([("M", "FT"), ("DEG_C", "DEG_F"), ("DEG", "ARCSEC")]))
def test_a_conversion_there_and_back_changes_no_more_than_the_last_digits(value: float, units: tuple[str, str]) -> None:
    one, other = (UNIT + unit for unit in units)
    there = convert(value, one, other)
    assert there is not None
    assert convert(there, other, one) == pytest.approx(value, rel=1e-9, abs=1e-9)


def test_every_unit_of_a_field_or_of_a_convention_can_be_converted() -> None:
    used = {each.object.value for each in module_triples("units") if each.predicate == qudt.hasUnit}
    used |= {quantity.unit for table in (_BY_SUFFIX, _BY_WORD) for quantity in table.values()}
    assert used - _factors().keys() == set()


SYMBOLS = {
    "M-PER-SEC": "m/s", "M-PER-SEC2": "m/s²", "KiloM-PER-HR": "km/h", "RAD-PER-SEC": "rad/s", "REV-PER-MIN": "rpm",
    "N-M": "N·m", "KiloGM-M2": "kg·m²", "J-PER-KiloGM-K": "J/(kg·K)", "PER-SEC": "1/s", "DEG": "°", "DEG_C": "°C",
    "PERCENT": "%", "UNITLESS": "", "FRACTION": "", "PIXEL_COUNT": "px", "A-HR": "Ah", "FT-PER-MIN": "ft/min",
}  # fmt: skip
UNKNOWN = ("FURLONG-PER-FORTNIGHT", "M-PER-SEC-PER-SEC", "Kilo", "m-per-sec")


def test_a_unit_of_qudt_has_its_symbol_and_any_other_its_name() -> None:
    expected = SYMBOLS | {name: name for name in UNKNOWN}
    assert {name: symbol_of(UNIT + name) for name in expected} == expected
    assert symbol_of("http://www.ontology-of-units-of-measure.org/resource/om-2/metre") == "metre"


@given(st.text())
def test_no_name_is_too_strange(name: str) -> None:
    assert isinstance(symbol_of(UNIT + name), str)
