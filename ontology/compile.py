"""Compiler of lifters: message types to Python source, one function per type and notation.

A generated function binds the fields it needs, formats all its numbers in one call, and returns one f-string. Nested
messages are inlined while they are small; arrays of messages, and large nested ones, call the function of their type:

    def geometry_msgs_Point(m, n, e, s, x):
        v0, v1, v2, = scalars((m.x, m.y, m.z,))
        return f'<{n}> <http://...type> <.../Point>{e}{x}<{n}> <.../Point#x> "{v0}"^^<...double>{e}...'
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from itertools import count
from struct import Struct
from typing import cast

from rosld.adapters.model import OCTETS, STRINGS, Array, Field, MessageSchema, MessageType, Nested, Primitive
from rosld.ontology.literals import (
    DATATYPES,
    DTYPES,
    base64_text,
    date_time,
    unpack_float32,
    wide_integer_json,
    wire_length,
)
from rosld.ontology.names import TypeName, type_names
from rosld.ontology.syntax_codegen import Json, Notation, Site
from rosld.ontology.vocab import rdf, ros

TIME = "builtin_interfaces/msg/Time"
_MAX_INLINED = 96
_TYPE, _DATE_TIME = rdf.type.value, ros.dateTime.value
_OF_VALUES = frozenset(one.value for one in (rdf.first, rdf.rest, ros.elidedLength, ros.bytes))
"""Predicates of field values; a query that uses one needs every field."""
_ATTRIBUTE = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")

Lift = Callable[[object, str, str, Site, str], str]
"""A generated function: (message, node, end of line, site, addition to the node) to text."""


def compile_lift(
    schema: MessageSchema,
    notation: Notation,
    types: str,
    inline_limit: int,
    only: frozenset[str] | None = None,
    *,
    is_linked: bool = False,
) -> Lift:
    """Return the function that writes messages of `schema`. Raises ValueError for an invalid or recursive type.

    `only` (None for all) are the needed predicates: statements with other predicates may be omitted. With `is_linked`,
    so may statements about nodes that are not reachable by these.
    """
    return _Module(schema, notation, types, inline_limit, only, is_linked).lift()


def minimum_size(kind: Nested | Primitive, types: Mapping[str, MessageType]) -> int:
    """Return the minimum number of bytes of an array element on the wire of ROS 1."""
    if isinstance(kind, Primitive):
        return 4 if kind.name in STRINGS else DTYPES[kind.name].itemsize
    return max(1, sum(_field_size(field, types) for field in types[kind.name].fields))


def _field_size(field: Field, types: Mapping[str, MessageType]) -> int:
    if isinstance(field.type, Array):
        return 4 if field.type.length is None else field.type.length * minimum_size(field.type.element, types)
    return minimum_size(field.type, types)


class _Module:
    """Functions of one schema in one notation, compiled on first use and sharing one namespace."""

    def __init__(
        self,
        schema: MessageSchema,
        notation: Notation,
        types: str,
        inline_limit: int,
        only: frozenset[str] | None,
        is_linked: bool,
    ) -> None:
        self.types = schema.types
        self._only = None if only is None or not only.isdisjoint(_OF_VALUES) else only
        self._is_linked = is_linked
        self.notation = notation
        self.inline_limit = inline_limit
        self.names = type_names(schema.types, types)
        self._root = schema.ref.name
        self._leaves: dict[str, int] = {}
        self._functions: dict[str, str] = {}
        self._wanted: list[str] = []
        self.namespace: dict[str, object] = {
            **notation.runtime._asdict(),
            "base64_text": base64_text,
            "date_time": date_time,
            "octet_count": wire_length,
            "singles": unpack_float32,
            "wide": wide_integer_json,
        }

    def lift(self) -> Lift:
        self.leaves(self._root, ())
        root = self.function(self._root)
        sources = []
        while self._wanted:
            name = self._wanted.pop()
            sources.append(_Function(self, self.types[name]).source(self._functions[name]))
        exec(compile("\n".join(sources), f"<lifter of {self._root}>", "exec"), self.namespace)
        return cast(Lift, self.namespace[root])

    def function(self, name: str) -> str:
        """Return the name of the function of a type and schedule its compilation."""
        if name not in self._functions:
            self._functions[name] = f"lift_{len(self._functions)}"
            self._wanted.append(name)
        return self._functions[name]

    def leaves(self, name: str, above: tuple[str, ...]) -> int:
        """Return the number of statements of a type inlined completely. Raises ValueError for a recursive type."""
        if name in above:
            raise ValueError(f"the type {name} contains itself")
        if name not in self._leaves:
            self._leaves[name] = 1 + sum(self._field_leaves(field, (*above, name)) for field in self.types[name].fields)
        return self._leaves[name]

    def _field_leaves(self, field: Field, above: tuple[str, ...]) -> int:
        if isinstance(field.type, Array) and isinstance(field.type.element, Nested):
            self.leaves(field.type.element.name, above)
        return 1 + self.leaves(field.type.name, above) if isinstance(field.type, Nested) else 1

    def is_wanted(self, predicate: str) -> bool:
        """Whether statements with a predicate are needed."""
        return self._only is None or predicate in self._only

    def is_field_wanted(self, kind: TypeName, field: Field) -> bool:
        """Whether a field, or anything within it, is needed."""
        if self.is_wanted(kind.property(field.name)):
            return True
        return not self._is_linked and self._is_type_wanted(field.nested)

    def _is_type_wanted(self, name: str | None) -> bool:
        if name is None or self._only is None:
            return self._only is None
        if self.is_wanted(_TYPE) or (name == TIME and self.is_wanted(_DATE_TIME)):
            return True
        return any(self.is_field_wanted(self.names[name], field) for field in self.types[name].fields)

    def inlined(self, name: str) -> bool:
        """Whether nested messages of this type are inlined."""
        return self.leaves(name, ()) <= _MAX_INLINED


class _Function:
    """A generated function under construction."""

    def __init__(self, module: _Module, kind: MessageType) -> None:
        self._module = module
        self._notation = module.notation
        self._kind = kind
        self._numbers = count()
        self._lines: list[str] = []
        self._exact: dict[str, str] = {}
        self._single: dict[str, str] = {}

    def source(self, name: str) -> str:
        """Return the source of the function for this type."""
        text = self._block(self._kind, "m", "{n}", "{x}")
        lines = [*self._lines, *self._batches(), f"return f'{text}'"]
        return f"def {name}(m, n, e, s, x=''):\n " + "\n ".join(lines) + "\n"

    def _batches(self) -> Iterator[str]:
        """Yield the formatting calls: one for all numbers, and one for the float32s, whose digits differ."""
        if self._exact:
            yield f"{', '.join(self._exact)}, = scalars(({', '.join(self._exact.values())},))"
        if self._single:
            packer = f"pack_{len(self._single)}"
            self._module.namespace[packer] = Struct(f"<{len(self._single)}f").pack
            yield f"{', '.join(self._single)}, = scalars(singles({packer}({', '.join(self._single.values())})))"

    def _new(self, value: str, prefix: str = "v") -> str:
        name = f"{prefix}{next(self._numbers)}"
        self._lines.append(f"{name} = {value}")
        return name

    def _block(self, kind: MessageType, message: str, subject: str, extra: str = "") -> str:
        """Return the fragment of a whole message: its own statement, and those of nested messages if they follow it."""
        notation, name = self._notation, self._module.names[kind.name]
        head = notation.head(subject, name)
        statements = head if self._module.is_wanted(_TYPE) else ""
        members, after = [statements + extra if head else ""], []
        for field in kind.fields:
            if not self._module.is_field_wanted(name, field):
                continue
            member, rest = self._field(name, field, f"{message}.{_attribute(field)}", subject)
            members.append(member)
            after.append(rest)
        own = notation.separator.join([member for member in members if member])
        return "".join([notation.begin, own, self._time(kind, message, subject), notation.end, *after])

    def _time(self, kind: MessageType, message: str, subject: str) -> str:
        """Return the derived xsd:dateTime of a stamp."""
        is_wanted = kind.name == TIME and self._module.is_wanted(_DATE_TIME)
        text = self._notation.time(subject, "{t}") if is_wanted else ""
        if not text:
            return ""
        sec, nanosec = f"{message}.sec", f"{message}.nanosec"  # both 0: not set (std_msgs/Header), or the latest (tf2)
        self._lines.append(f"t = date_time({sec}, {nanosec}) if ({sec} or {nanosec}) and not s.simulated_time else ''")
        return "{" + self._new(f"f'{text}' if t else ''") + "}"

    def _field(self, kind: TypeName, field: Field, value: str, subject: str) -> tuple[str, str]:
        """Return the fragment of a field and the text that follows its statement."""
        node = f"{subject}.{field.name}"
        if isinstance(field.type, Primitive):
            written, after = self._primitive(field.type, value, node)
        elif isinstance(field.type, Nested):
            written, after = self._nested_message(field.type.name, value, node)
        elif isinstance(field.type.element, Primitive):
            written, after = self._array(field.type.element, field.type.length, value, node)
        else:
            key, written, after = self._messages(
                field.type.element, (field.name, kind.property(field.name)), value, node
            )
            return self._notation.field(subject, kind, field.name, written, key), after
        return self._notation.field(subject, kind, field.name, written), after

    def _primitive(self, kind: Primitive, value: str, node: str) -> tuple[str, str]:
        if kind.name in STRINGS:
            text, limit = self._new(value), self._module.inline_limit
            too_large = f"len({text}) > {limit // 4} and octet_count({text}) > {limit}"
            return self._unless(too_large, text, node, f"string({text}), ''")
        name = f"v{next(self._numbers)}"
        if kind.name == "float32":
            self._single[name] = value
        else:
            is_wide = kind.name.endswith("int64") and isinstance(self._notation, Json)
            self._exact[name] = f"wide({value})" if is_wide else value
        return self._notation.literal(DATATYPES[kind.name], f"{{{name}}}"), ""

    def _nested_message(self, name: str, value: str, node: str) -> tuple[str, str]:
        if self._module.inlined(name):
            text = self._block(self._module.types[name], self._new(value, "m"), node)
        else:
            call = f"{self._module.function(name)}({value}, f'{node}', e, s)"
            text = "{" + self._new(call) + "}"
        return (text, "") if self._notation.inside else (self._notation.node(node), text)

    def _array(self, element: Primitive, length: int | None, value: str, node: str) -> tuple[str, str]:
        """Return an array of primitives, which is one literal."""
        values, limit = self._new(value), self._module.inline_limit
        if element.name in STRINGS:
            too_large = f"4 * len({values}) + sum(map(octet_count, {values})) > {limit}"
            literal = self._notation.json(f"{{strings({values})}}")
        elif element.name in OCTETS:
            too_large = f"{values}.nbytes > {limit}"
            literal = self._notation.literal("base64Binary", f"{{base64_text({values})}}")
        else:
            too_large = f"{values}.nbytes > {limit}"
            literal = self._notation.json(f"{{numbers({values})}}")
        if length is not None and length * minimum_size(element, {}) <= limit and element.name not in STRINGS:
            return "{" + self._new(f"f'{literal}'") + "}", ""
        return self._unless(too_large, values, node, f"f'{literal}', ''")

    def _messages(self, element: Nested, keys: tuple[str, str], value: str, node: str) -> tuple[str, str, str]:
        """Return an array of messages and its key: in JSON-LD an elided one is no list and has its full IRI as key."""
        values, function = self._new(value), self._module.function(element.name)
        too_large = f"len({values}) * {minimum_size(element, self._module.types)} > {self._module.inline_limit}"
        key = self._new(f"{keys[1]!r} if {too_large} else {keys[0]!r}", "k")
        texts = f"[{function}(i, f'{node}.{{j}}', e, s) for j, i in enumerate({values})]"
        return f"{{{key}}}", *self._unless(too_large, values, node, f"listing(f'{node}', {texts}, e)")

    def _unless(self, too_large: str, value: str, node: str, inline: str) -> tuple[str, str]:
        """Return the value and the text that follows it: `inline` returns both unless the value is elided."""
        number = next(self._numbers)
        elided = f"elide(f'{node}', len({value}), e, s)"
        self._lines.append(f"o{number}, a{number} = {elided} if {too_large} else ({inline})")
        return f"{{o{number}}}", f"{{a{number}}}"


def _attribute(field: Field) -> str:
    """Return the attribute of a field after checking that it is an identifier: it becomes source code."""
    if not (_ATTRIBUTE.fullmatch(field.attribute) and _ATTRIBUTE.fullmatch(field.name)):
        raise ValueError(f"{field.name!r} is not a ROS field name")
    return field.attribute
