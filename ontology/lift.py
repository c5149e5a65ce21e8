"""Lifting: ROS messages to RDF, compiled once per schema into generated Python functions.

`compile.py` writes the functions, `syntax_codegen.py` defines the syntaxes, `literals.py` writes values.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from functools import lru_cache, partial
from types import MappingProxyType
from typing import TYPE_CHECKING

from msgspec import Struct
from msgspec.structs import replace
from pyoxigraph import RdfFormat, Triple, parse

from rosld.adapters.model import OCTETS, STRINGS, FieldType, Message, MessageSchema, Nested, Primitive
from rosld.ontology.compile import Lift, compile_lift
from rosld.ontology.literals import DATATYPES, date_time
from rosld.ontology.names import TypeName, type_names
from rosld.ontology.syntax_codegen import NOTATIONS, Site
from rosld.ontology.vocab import rdf, ros, xsd

if TYPE_CHECKING:
    from rosld.ontology.document import Envelope

TYPES = "https://w3id.org/rosld/types/"

TERMS: Mapping[str, object] = MappingProxyType(
    {
        "ros": ros.iri,
        "ros:received": {"@id": ros.received.value, "@type": xsd.dateTime.value},
        "ros:sequence": {"@id": ros.sequence.value, "@type": xsd.integer.value},
        "ros:sentBy": {"@id": ros.sentBy.value, "@type": "@id"},
        "ros:dateTime": {"@id": ros.dateTime.value, "@type": xsd.dateTime.value},
        "ros:elidedLength": {"@id": ros.elidedLength.value, "@type": xsd.integer.value},
        "ros:bytes": {"@id": ros.bytes.value, "@type": "@id"},
    }
)
"""JSON-LD terms of every lifter's context: those of the envelope, of stamps and of elided values."""


class LiftSettings(Struct, frozen=True):
    """`types`: the namespace of message types; `inline_limit`: bytes above which an array or string is elided."""

    types: str = TYPES
    inline_limit: int = 65536

    @property
    def unelided(self) -> LiftSettings:
        """Return the settings without a limit, so that nothing is elided."""
        return replace(self, inline_limit=1 << 62)


class Lifter:
    """Writer of messages of one schema; each syntax is compiled on first use.

    `document` is the absolute URL, `node` the fragment (`#message`), `source` the URL of the bytes of elided fields if
    it is not the document.
    """

    def __init__(
        self,
        schema: MessageSchema,
        settings: LiftSettings,
        only: frozenset[str] | None = None,
        *,
        is_linked: bool = False,
    ) -> None:
        """`only` are the needed predicates, None for all: N-Triples may omit statements with other predicates.

        With `is_linked`, they may also omit statements about nodes that are not reachable by these.
        """
        names = type_names(schema.types, settings.types)
        self.schema = schema
        self.prefixes: Mapping[str, str] = MappingProxyType(_prefixes(names.values()))
        self.context: Mapping[str, object] = MappingProxyType({**TERMS, **_terms(schema, names)})
        self._settings = settings
        self._only = only
        self._is_linked = is_linked
        self._compiled: dict[str, Lift] = {}
        self.ntriples, self.turtle, self.jsonld = (
            partial(self.text, each) for each in ("ntriples", "turtle", "jsonld")
        )

    def text(
        self, notation: str, message: Message, document: str, node: str, *, end: str = " .\n",
        envelope: Envelope | None = None, simulated_time: bool = False, source: str | None = None,
    ) -> str:  # fmt: skip
        """Return a message in a notation.

        Turtle and JSON-LD (a node object) are relative to the document, whose prefixes include `prefixes` or whose
        context `context`. N-Triples with `end=" <graph> .\\n"` are N-Quads.
        """
        subject = document + node if notation == "ntriples" else node
        extra = "" if envelope is None else _ENVELOPES[notation](subject, envelope, end, self._only)
        lift = self._compiled.get(notation) or self._compile(notation)
        return lift(message, subject, end, Site(source or document, len(subject) + 1, simulated_time), extra)

    def json(self, message: Message, document: str) -> bytes:
        """Return ROS's own JSON of the message (`document` is for the URLs of elided values)."""
        return self.text("json", message, document, "").encode()

    def triples(self, message: Message, document: str, node: str, *, envelope: Envelope | None = None) -> list[Triple]:
        """Return the triples as terms."""
        # Parsing N-Triples costs less than creating the terms one by one from Python.
        text = self.ntriples(message, document, node, envelope=envelope)
        return [quad.triple for quad in parse(text, RdfFormat.N_TRIPLES)]

    def _compile(self, notation: str) -> Lift:
        only = self._only if notation == "ntriples" else None
        settings = self._settings
        lift = self._compiled[notation] = compile_lift(
            self.schema, NOTATIONS[notation], settings.types, settings.inline_limit, only, is_linked=self._is_linked
        )
        return lift


@lru_cache(maxsize=1024)
def lifter(schema: MessageSchema, settings: LiftSettings = LiftSettings()) -> Lifter:  # noqa: B008
    """Return the lifter of a schema, compiled once per schema and settings.

    Raises ValueError for a recursive type or an invalid type name.
    """
    return Lifter(schema, settings)


@lru_cache(maxsize=256)
def partial_lifter(
    schema: MessageSchema, settings: LiftSettings, only: frozenset[str] | None, *, is_linked: bool = False
) -> Lifter:
    """Return the lifter, in N-Triples, of a schema's statements with these predicates (None: all). Raises as `lifter`.

    `is_linked`: nodes that are not reachable by these predicates are not needed.
    """
    if only is None:
        return lifter(schema, settings)
    return Lifter(schema, settings, only, is_linked=is_linked)


def _ntriples_envelope(subject: str, envelope: Envelope, end: str, only: frozenset[str] | None) -> str:
    publisher = envelope.publisher
    statements = ""
    if only is None or _RECEIVED in only:
        statements = f'<{subject}> <{_RECEIVED}> "{date_time(0, envelope.received_ns)}"^^<{_DATE_TIME}>{end}'
    if only is None or _SEQUENCE in only:
        statements += f'<{subject}> <{_SEQUENCE}> "{envelope.sequence}"^^<{_INTEGER}>{end}'
    if publisher is not None and (only is None or _PUBLISHER in only):
        statements += f"<{subject}> <{_PUBLISHER}> <{publisher}>{end}"
    return statements


def _turtle_envelope(subject: str, envelope: Envelope, end: str, only: frozenset[str] | None) -> str:
    received = f' ;\n    ros:received "{date_time(0, envelope.received_ns)}"^^xsd:dateTime'
    publisher = "" if envelope.publisher is None else f" ;\n    ros:sentBy <{envelope.publisher}>"
    return f"{received} ;\n    ros:sequence {envelope.sequence}{publisher}"


def _jsonld_envelope(subject: str, envelope: Envelope, end: str, only: frozenset[str] | None) -> str:
    publisher = "" if envelope.publisher is None else f',"ros:sentBy":"{envelope.publisher}"'
    received = date_time(0, envelope.received_ns)
    return f',"ros:received":"{received}","ros:sequence":"{envelope.sequence}"{publisher}'


_ENVELOPES = {"ntriples": _ntriples_envelope, "turtle": _turtle_envelope, "jsonld": _jsonld_envelope}

_RECEIVED, _SEQUENCE, _PUBLISHER = ros.received.value, ros.sequence.value, ros.sentBy.value
_DATE_TIME, _INTEGER = xsd.dateTime.value, xsd.integer.value


def _prefixes(names: Iterable[TypeName]) -> dict[str, str]:
    """Return the prefixes of values, and two per type: that of its package for the class, its own for fields."""
    prefixes = {"ros": ros.iri, "rdf": rdf.iri, "xsd": xsd.iri}
    for name in names:
        prefixes[name.package] = name.namespace
        prefixes[name.prefix] = name.iri + "#"
    return prefixes


def _terms(schema: MessageSchema, names: Mapping[str, TypeName]) -> dict[str, object]:
    """Return a term per type, whose scoped context defines the properties and datatypes of its fields."""
    return {
        names[kind.name].term: {
            "@id": names[kind.name].iri,
            "@context": {
                field.name: {"@id": names[kind.name].property(field.name), **_coercion(field.type)}
                for field in kind.fields
            },
        }
        for kind in schema.types.values()
    }


def _coercion(kind: FieldType) -> dict[str, str]:
    """Return the coercion of a field's value (a string or an array in JSON)."""
    if isinstance(kind, Nested):
        return {"@type": "@id"}
    if isinstance(kind, Primitive):
        return {} if kind.name in STRINGS else {"@type": xsd.iri + DATATYPES[kind.name]}
    if isinstance(kind.element, Nested):
        return {"@type": "@id", "@container": "@list"}
    return {"@type": xsd.base64Binary.value if kind.element.name in OCTETS else rdf.JSON.value}
