"""Messages of any type by hypothesis, and how a whole document looks in each syntax."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_typestore

from rosld.adapters.model import Array, FieldType, Message, MessageSchema, Nested, Primitive, TypeRef
from rosld.adapters.model.library import TypeLibrary
from rosld.ontology.literals import DTYPES, STRINGS

LIBRARIES = {version: TypeLibrary(ros_version=version) for version in (1, 2)}  # type: ignore[arg-type]
STORED = [
    *((1, name) for name in sorted(get_typestore(Stores.ROS1_NOETIC).fielddefs)),
    *((2, name) for name in sorted(get_typestore(Stores.ROS2_JAZZY).fielddefs)),
]
EMPTY = "structure_needs_at_least_one_member"

INTEGERS = {
    name: st.integers(int(np.iinfo(dtype).min), int(np.iinfo(dtype).max))
    | st.sampled_from([int(np.iinfo(dtype).min), int(np.iinfo(dtype).max), 0])
    for name, dtype in DTYPES.items()
    if dtype.kind in "iu"
}
FLOATS = {name: st.floats(width=width) for name, width in (("float32", 32), ("float64", 64))}
TEXTS = st.text(st.characters(exclude_categories=["Cs"]), max_size=8) | st.sampled_from(
    ['"', "a\nb\r\tc", "\x00", "\\", "\x7f\x85", "𝄞 ü", "#<>{}", "'''\"\"\"", "�￾"]
)
BYTES = st.binary(max_size=5).map(lambda octets: octets.decode("utf-8", "surrogateescape"))


class Filler:
    """Strategies for the messages of one schema."""

    def __init__(self, schema: MessageSchema, texts: st.SearchStrategy[str]) -> None:
        self.schema = schema
        self.texts = texts
        self.known: dict[str, st.SearchStrategy[Message]] = {}

    def message(self, name: str) -> st.SearchStrategy[Message]:
        if name not in self.known:
            fields = {field.attribute: self.field(field.type) for field in self.schema.types[name].fields}
            self.known[name] = st.fixed_dictionaries(fields).map(lambda v: self.schema.codec.build(name, v))
        return self.known[name]

    def field(self, kind: FieldType) -> st.SearchStrategy[object]:
        if isinstance(kind, Nested):
            return self.message(kind.name)
        if isinstance(kind, Array):
            return self.array(kind)
        return self.primitive(kind)

    def primitive(self, kind: Primitive) -> st.SearchStrategy[object]:
        if kind.name in STRINGS:
            bound = kind.bound
            return self.texts if bound is None else self.texts.filter(lambda text: len(text.encode()) <= bound)
        if kind.name == "bool":
            return st.booleans()
        return FLOATS[kind.name] if kind.name in FLOATS else INTEGERS[kind.name]

    def array(self, kind: Array) -> st.SearchStrategy[object]:
        least, limit = (0, min(3, kind.bound or 3)) if kind.length is None else (kind.length, kind.length)
        element = kind.element
        if isinstance(element, Nested):
            return st.lists(self.message(element.name), min_size=least, max_size=min(limit, max(least, 2)))
        values = st.lists(self.primitive(element), min_size=least, max_size=limit)
        if element.name in STRINGS:
            return values
        dtype = DTYPES[element.name]
        return values.map(lambda numbers: np.array(numbers, dtype))


def schema_of(version: int, name: str) -> MessageSchema:
    schema = LIBRARIES[version].find(TypeRef(name))
    assert isinstance(schema, MessageSchema)
    return schema


def same(one: object, other: object) -> bool:
    """Equal in every bit that matters: NaN is NaN, -0.0 is not 0.0, an int is no float, dtypes agree."""
    if isinstance(one, np.ndarray):
        return isinstance(other, np.ndarray) and one.dtype == other.dtype and same(one.tolist(), other.tolist())
    if type(one) is not type(other):
        return False
    if isinstance(one, list) and isinstance(other, list):
        return len(one) == len(other) and all(map(same, one, other))
    if isinstance(one, float) and isinstance(other, float):
        return (one != one and other != other) or (one == other and math.copysign(1, one) == math.copysign(1, other))
    if hasattr(one, "__msgtype__"):
        return all(same(value, getattr(other, name)) for name, value in vars(one).items() if name != EMPTY)
    return one == other


@pytest.fixture(scope="session")
def find_schema() -> Callable[[int, str], MessageSchema]:
    return schema_of


@pytest.fixture(scope="session")
def messages() -> Callable[[MessageSchema, int], st.SearchStrategy[Message]]:
    """(schema, ROS version) to a strategy of its messages; in ROS 1 strings may be any bytes."""
    made: dict[tuple[MessageSchema, int], st.SearchStrategy[Message]] = {}

    def strategy(schema: MessageSchema, version: int) -> st.SearchStrategy[Message]:
        key = (schema, version)
        if key not in made:
            made[key] = Filler(schema, TEXTS | BYTES if version == 1 else TEXTS).message(schema.ref.name)
        return made[key]

    return strategy


@pytest.fixture(scope="session")
def equal() -> Callable[[object, object], bool]:
    return same


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """A test that asks for a `stored_type` runs for every type that rosbags ships."""
    if "stored_type" in metafunc.fixturenames:
        metafunc.parametrize("stored_type", STORED, ids=[f"ros{version}-{name}" for version, name in STORED])
