"""Code generation for lifters: the parts of a message in each syntax, as Python source.

A *fragment* is the inside of an f-string: its constant parts have passed `const`, the rest are names that the generated
function binds. All notations share these names: `n` is the node (an absolute IRI in N-Triples, `#message` in Turtle and
JSON-LD, the path in JSON), `e` the end of an N-Triples line, `x` the addition to the node.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from hashlib import blake2b
from typing import NamedTuple, Protocol

from rosld.ontology.literals import (
    BASE64,
    base64_text,
    json_numbers,
    json_scalars,
    json_string,
    json_strings,
    quote,
    scalar_texts,
    wire_bytes,
)
from rosld.ontology.names import TypeName
from rosld.ontology.vocab import rdf, ros, xsd

_ESCAPES = {"\\": "\\\\", "'": "\\'", "\n": "\\n", "\r": "\\r", "{": "{{", "}": "}}"}


def const(text: str) -> str:
    """Return constant text as a fragment."""
    return "".join([_ESCAPES.get(character, character) for character in text])


class Site(NamedTuple):
    """The target of lifting a message.

    `source` is the URL of its bytes, `start` the index in a node where the path of the field begins.
    """

    source: str
    start: int
    simulated_time: bool

    def href(self, node: str) -> str:
        """Return the URL of the bytes of an elided field."""
        return f"{self.source}{'&' if '?' in self.source else '?'}field={node[self.start :]}"


Elide = Callable[[str, int, str, Site], "tuple[str, str]"]
Listing = Callable[[str, Sequence[str], str], "tuple[str, str]"]


class Runtime(NamedTuple):
    """The functions of a notation that its generated code calls.

    `elide` (node, length, end, site) and `listing` (node, texts of the elements, end) return the replacement of the
    value and the statements that follow its own.
    """

    scalars: Callable[[tuple[bool | int | float, ...]], list[str]]
    string: Callable[[str], str]
    numbers: Callable[..., str]
    strings: Callable[[list[str]], str]
    elide: Elide
    listing: Listing


class Notation(Protocol):
    """A syntax. `inside`: a nested message is written within the statement that links to it, not after."""

    inside: bool
    separator: str
    begin: str
    end: str
    runtime: Runtime

    def head(self, subject: str, kind: TypeName) -> str:
        """Return the node itself with its type; empty if the syntax has neither."""
        ...

    def field(self, subject: str, kind: TypeName, name: str, value: str, key: str | None = None) -> str:
        """Return a field and its value. `key` replaces the name if that depends on the value (JSON-LD)."""
        ...

    def time(self, subject: str, value: str) -> str:
        """Return the derived ros:dateTime; empty if the syntax has none."""
        ...

    def literal(self, datatype: str, value: str) -> str:
        """Return a number, bool or octets; `datatype` is XSD's local name."""
        ...

    def json(self, value: str) -> str:
        """Return the JSON of an array of numbers or bools."""
        ...

    def node(self, subject: str) -> str:
        """Return a link to a nested node."""
        ...


def _n_string(value: str) -> str:
    try:
        return quote(value)
    except TypeError:
        return f'"{base64_text(wire_bytes(value))}"^^<{BASE64}>'


def _turtle_string(value: str) -> str:
    try:
        return quote(value)
    except TypeError:
        return f'"{base64_text(wire_bytes(value))}"^^xsd:base64Binary'


def _n_elide(node: str, length: int, end: str, site: Site) -> tuple[str, str]:
    return f"<{node}>", (
        f"<{node}> <{rdf.type.value}> <{ros.Elided.value}>{end}"
        f'<{node}> <{ros.elidedLength.value}> "{length}"^^<{xsd.integer.value}>{end}'
        f"<{node}> <{ros.bytes.value}> <{site.href(node)}>{end}"
    )


def _turtle_elide(node: str, length: int, end: str, site: Site) -> tuple[str, str]:
    about = f"<{node}> a ros:Elided ;\n    ros:elidedLength {length} ;\n    ros:bytes <{site.href(node)}> .\n"
    return f"<{node}>", about


def _jsonld_elide(node: str, length: int, end: str, site: Site) -> tuple[str, str]:
    href = site.href(node)
    return f'{{"@id":"{node}","@type":"ros:Elided","ros:elidedLength":"{length}","ros:bytes":"{href}"}}', ""


def _json_elide(node: str, length: int, end: str, site: Site) -> tuple[str, str]:
    return f'{{"elided":true,"length":{length},"href":"{site.href(node)}"}}', ""


_FIRST, _REST, _NIL = rdf.first.value, rdf.rest.value, rdf.nil.value


def _n_listing(node: str, texts: Sequence[str], end: str) -> tuple[str, str]:
    """Return list cells, whose labels derive from their list's IRI to be distinct in a file of many documents."""
    if not texts:
        return f"<{_NIL}>", ""
    cell = f"_:l{blake2b(node.encode(), digest_size=10).hexdigest()}-"
    links = [
        f"{cell}{i} <{_FIRST}> <{node}.{i}>{end}{cell}{i} <{_REST}> {cell}{i + 1}{end}{text}"
        for i, text in enumerate(texts[:-1])
    ]
    last = len(texts) - 1
    links.append(f"{cell}{last} <{_FIRST}> <{node}.{last}>{end}{cell}{last} <{_REST}> <{_NIL}>{end}{texts[-1]}")
    return f"{cell}0", "".join(links)


def _turtle_listing(node: str, texts: Sequence[str], end: str) -> tuple[str, str]:
    return f"({''.join([f' <{node}.{i}>' for i in range(len(texts))])} )", "".join(texts)


def _json_listing(node: str, texts: Sequence[str], end: str) -> tuple[str, str]:
    return f"[{','.join(texts)}]", ""


def _literal_numbers(values: object) -> str:
    return json_numbers(values, '\\"')  # type: ignore[arg-type]


def _literal_strings(values: list[str]) -> str:
    return quote(json_strings(values))[1:-1]


class NTriples:
    """N-Triples and, with other line ends, N-Quads."""

    inside = False
    separator = begin = end = ""
    runtime = Runtime(scalar_texts, _n_string, _literal_numbers, _literal_strings, _n_elide, _n_listing)

    def head(self, subject: str, kind: TypeName) -> str:
        return f"<{subject}> " + const(f"<{rdf.type.value}> <{kind.iri}>") + "{e}"

    def field(self, subject: str, kind: TypeName, name: str, value: str, key: str | None = None) -> str:
        return f"<{subject}> " + const(f"<{kind.property(name)}>") + f" {value}{{e}}"

    def time(self, subject: str, value: str) -> str:
        return f"<{subject}> " + const(f"<{ros.dateTime.value}> ") + self.literal("dateTime", value) + "{e}"

    def literal(self, datatype: str, value: str) -> str:
        return f'"{value}"' + const(f"^^<{xsd.iri}{datatype}>")

    def json(self, value: str) -> str:
        return f'"{value}"' + const(f"^^<{rdf.JSON.value}>")

    def node(self, subject: str) -> str:
        return f"<{subject}>"


class Turtle(NTriples):
    """Turtle for people: one statement per node, with prefixes and short forms."""

    end = const(" .\n")
    runtime = Runtime(scalar_texts, _turtle_string, _literal_numbers, _literal_strings, _turtle_elide, _turtle_listing)

    def head(self, subject: str, kind: TypeName) -> str:
        return f"<{subject}> " + const(f"a {kind.package}:{kind.short}")

    def field(self, subject: str, kind: TypeName, name: str, value: str, key: str | None = None) -> str:
        return const(f" ;\n    {kind.prefix}:{name} ") + value

    def time(self, subject: str, value: str) -> str:
        return const(" ;\n    ros:dateTime ") + self.literal("dateTime", value)

    def literal(self, datatype: str, value: str) -> str:
        return value if datatype == "boolean" else f'"{value}"^^xsd:{datatype}'

    def json(self, value: str) -> str:
        return f'"{value}"^^rdf:JSON'


class JsonLd:
    """JSON-LD, compact: node objects nested as in the message, each typed so that its context applies."""

    inside = True
    separator = ","
    begin, end = const("{"), const("}")
    runtime = Runtime(scalar_texts, json_string, _literal_numbers, _literal_strings, _jsonld_elide, _json_listing)

    def head(self, subject: str, kind: TypeName) -> str:
        return f'"@id":"{subject}","@type":"' + const(kind.term) + '"'

    def field(self, subject: str, kind: TypeName, name: str, value: str, key: str | None = None) -> str:
        return f'"{key or const(name)}":{value}'

    def time(self, subject: str, value: str) -> str:
        return f',"ros:dateTime":"{value}"'

    def literal(self, datatype: str, value: str) -> str:
        return f'"{value}"'

    def json(self, value: str) -> str:
        return f'"{value}"'

    def node(self, subject: str) -> str:
        raise NotImplementedError("a nested message is written inside")


class Json(JsonLd):
    """ROS's own JSON: the fields and nothing else."""

    runtime = Runtime(json_scalars, json_string, json_numbers, json_strings, _json_elide, _json_listing)

    def head(self, subject: str, kind: TypeName) -> str:
        return ""

    def field(self, subject: str, kind: TypeName, name: str, value: str, key: str | None = None) -> str:
        return f'"{const(name)}":{value}'

    def time(self, subject: str, value: str) -> str:
        return ""

    def literal(self, datatype: str, value: str) -> str:
        return f'"{value}"' if datatype == "base64Binary" else value

    def json(self, value: str) -> str:
        return value


NOTATIONS: Mapping[str, Notation] = {
    "ntriples": NTriples(),
    "turtle": Turtle(),
    "jsonld": JsonLd(),
    "json": Json(),
}
