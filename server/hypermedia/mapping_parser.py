"""Mapping documents: parsed from RDF, validated against their shape, and by rules that SHACL cannot express.

Pure except for `load_mapping`. An invalid document is rejected as a whole, with every reason and its place. The parser
does not look at the robot: a document may name resources that do not exist yet.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from difflib import get_close_matches
from itertools import count
from pathlib import Path
from time import monotonic
from typing import TypeAlias, TypeVar

from msgspec import Struct
from pyoxigraph import BlankNode, Literal, NamedNode, Triple

from rosld.ontology.body import BodyError, RdfBody, Term, parse_body, parse_json
from rosld.ontology.syntax import Syntax
from rosld.ontology.turtle import prefixed_name
from rosld.ontology.units import Quantity
from rosld.ontology.urls import Space
from rosld.ontology.violations import LoweringError, Violation
from rosld.ontology.violations import brief_value as brief
from rosld.ontology.vocab import mapping, qudt, rdf, rdfs, sh
from rosld.server.hypermedia.mapping import (
    ComplexResource,
    Condition,
    MappedAction,
    MappedLink,
    MappedProperty,
    MappedStop,
)
from rosld.server.robot.software_stop import StopCommand
from rosld.shapes.shapes_graph import ShapesGraph, compile_shape
from rosld.shapes.validation import validate

Node: TypeAlias = NamedNode | BlankNode
Statements: TypeAlias = Mapping[NamedNode, Sequence[Term]]
_T = TypeVar("_T")

MAX_TRIPLES = 5_000
"""Maximum number of triples of a document. Their validation takes one or two seconds, or seven if all are invalid."""
_MAX_VIOLATIONS = 20
LONGEST_READING = 5.0
"""Maximum time in seconds to parse the conditions of a document."""
_WHEN = (mapping.writableWhen, mapping.availableWhen, mapping.existsWhen, mapping.atRestWhen)
_TELLING = (mapping.name, mapping.member, mapping.service, mapping.target, mapping.call, mapping.publish)
_TERMS = frozenset(mapping.terms.values())
_NEUTRAL = frozenset(
    NamedNode(sh.iri + name)
    for name in (
        "path", "property", "name", "description", "order", "group", "defaultValue", "message", "severity",
        "deactivated", "flags", "ignoredProperties", "targetNode", "targetClass", "targetSubjectsOf", "targetObjectsOf",
    )
)  # fmt: skip
"""Predicates of shapes that constrain nothing."""


class MappingDocument(Struct, frozen=True, eq=False):
    """A valid mapping document: its triples exactly as received, and the mapping that they describe."""

    url: str
    triples: tuple[Triple, ...]
    resources: tuple[ComplexResource, ...]


class InvalidMapping(LoweringError):
    """The document is no mapping, or conflicts with the others."""


def read_mapping(data: bytes, media_type: str, url: str, *, is_valid: bool = False) -> MappingDocument:
    """Return the mapping in `data`, with relative IRIs resolved against `url`; `is_valid` as in `mapping_of`.

    Raises BodyError for invalid syntax, InvalidMapping for an invalid mapping, ValueError for a media type that is no
    RDF syntax. Takes seconds for the largest documents: call it off the event loop.
    """
    return mapping_of(parse_body(data, media_type, url), url, is_valid=is_valid)


def load_mapping(path: Path, space: Space, name: str | None = None, *, is_valid: bool = False) -> MappingDocument:
    """Return the mapping in a file, with its `name` below `/mappings/` (by default that of the file).

    `is_valid` as in `mapping_of`. Raises OSError if the file cannot be read, and ValueError for an invalid mapping,
    each with the name of the file.
    """
    syntax = next((each for each in Syntax if f".{each.extension}" == path.suffix.lower()), None)
    if syntax is None:
        known = ", ".join(f".{each.extension}" for each in Syntax)
        raise ValueError(f"{path} cannot be read as a mapping: its name must end in {known}.")
    try:
        return read_mapping(
            path.read_bytes(), syntax.media_type, space.url("mappings", (name or path.stem,)), is_valid=is_valid
        )
    except ValueError as error:
        raise ValueError(f"{path} is not a mapping: {error}") from error


def mapping_of(body: RdfBody, url: str, *, is_valid: bool = False) -> MappingDocument:
    """Return the mapping that the triples of a body describe. Raises InvalidMapping.

    `is_valid` skips validation against the shape of mappings and the check of terms, for documents that passed it
    before: both are slow and need rdflib.
    """
    triples = tuple(_triples(body))
    if len(triples) > MAX_TRIPLES:
        raise InvalidMapping(
            Violation("", f"a mapping can have at most {MAX_TRIPLES} triples; split it into several documents")
        )
    if strange := next((each for each in triples if Triple in (type(each.subject), type(each.object))), None):
        raise InvalidMapping(Violation("", "a mapping cannot contain triple terms", brief(strange)))
    reader = _Reader(url, _conditions_named(triples, url))
    if not is_valid:
        reader.permissions()
        reader.check_terms()
    return MappingDocument(url, triples, reader.resources())


def _triples(body: RdfBody) -> Iterator[Triple]:
    for subject, properties in body.subjects.items():
        for predicate in properties:
            for object in body.objects(subject, predicate):
                yield Triple(subject, predicate, object)


def _conditions_named(triples: Sequence[Triple], url: str) -> list[Triple]:
    """Give every blank condition an IRI that identifies it in reports."""
    used = {node for triple in triples for node in (triple.subject, triple.object)}
    free = (node for number in count(1) if (node := NamedNode(f"{url}#condition.{number}")) not in used)
    blank = {triple.object: None for triple in triples if triple.predicate in _WHEN}
    names: dict[Term, NamedNode] = {node: next(free) for node in blank if isinstance(node, BlankNode)}
    return [
        Triple(names.get(subject, subject), predicate, names.get(object, object))
        for subject, predicate, object in triples
    ]


class _Reader:
    """Reader of one document, whose conditions all have IRIs; `found` are its violations."""

    def __init__(self, url: str, triples: Sequence[Triple]) -> None:
        self.url = url
        self.triples = triples
        self.statements: dict[Term, dict[NamedNode, list[Term]]] = {}
        for subject, predicate, object in triples:
            self.statements.setdefault(subject, {}).setdefault(predicate, []).append(object)
        self.places = _Places(url, triples, self.statements)
        self.found: dict[Violation, None] = {}
        self.conditions: dict[Term, Condition] = {}

    def permissions(self) -> None:
        """Validate the document against the shape of mappings. Raises InvalidMapping."""
        for misfit in validate(self.triples, "mapping"):
            self.wrong(misfit.focus, misfit.message, misfit.value, misfit.predicate, misfit.component)
        self.refuse()

    def resources(self) -> tuple[ComplexResource, ...]:
        """Return the complex resources by path. Raises InvalidMapping."""
        self.check_demands()
        self.refuse()
        self.check_conditions()
        self.refuse()
        nodes = [node for node, own in self.statements.items() if mapping.ComplexResource in own.get(rdf.type, ())]
        if not nodes:
            self.wrong(None, "the document does not describe a map:ComplexResource")
        resources = sorted((self.resource(node) for node in nodes), key=lambda one: (one.path, one.iri))
        self.check_paths(resources)
        self.check_sights(resources)
        self.refuse()
        return tuple(resources)

    # Resources

    def resource(self, node: Term) -> ComplexResource:
        """Return a complex resource."""
        assert isinstance(node, NamedNode)
        path = self.text(node, mapping.path)
        properties = [self.property(each, path) for each in self.objects(node, mapping.property)]
        actions = [self.action(each, path) for each in self.objects(node, mapping.action)]
        links = [self.link(each) for each in self.objects(node, mapping.link)]
        stops = [self.stop(each, path) for each in self.objects(node, mapping.stop)]
        found = ComplexResource(
            node.value,
            path,
            tuple(sorted(properties, key=lambda one: (one.name, one.predicate.value))),
            tuple(sorted(actions, key=lambda one: (one.name, one.relation.value))),
            tuple(sorted(links, key=lambda one: (one.relation.value, one.target))),
            self.when(node, mapping.existsWhen),
            self.title(node),
            tuple(sorted(stops, key=_order_of_stop)),
        )
        self.check_names(found)
        return found

    def property(self, node: Term, path: str) -> MappedProperty:
        """Return a property, with the full name of its member."""
        measured = (qudt.hasUnit, qudt.hasQuantityKind)
        member = _full(self.text(node, mapping.member), path)
        field = self.text(node, mapping.field) or None
        name = self.text(node, mapping.name) or (field or member).replace("." if field else "/", "/").rpartition("/")[2]
        return MappedProperty(
            self.relation(node, mapping.predicate),
            member,
            name,
            field,
            Quantity(*(each and each.value for each in (self.iri(node, term) for term in measured))),
            self.when(node, mapping.writableWhen),
        )

    def action(self, node: Term, path: str) -> MappedAction:
        """Return an action, with the full name of its service."""
        service = _full(self.text(node, mapping.service), path)
        return MappedAction(
            self.relation(node, mapping.relation),
            self.text(node, mapping.name) or service.rpartition("/")[2],
            service,
            self.when(node, mapping.availableWhen),
        )

    def link(self, node: Term) -> MappedLink:
        """Return a link."""
        return MappedLink(
            self.relation(node, mapping.relation),
            self.text(node, mapping.target),
            self.when(node, mapping.availableWhen),
        )

    def stop(self, node: Term, path: str) -> MappedStop:
        """Return a stop command, with full names."""
        service, topic = self.text(node, mapping.call), self.text(node, mapping.publish)
        if bool(service) == bool(topic):
            self.wrong(node, "a map:stop needs either map:call or map:publish, not both")
        content = self.text(node, mapping.content) or "{}"
        try:
            is_object = isinstance(parse_json(content.encode("utf-8", "replace")), dict)
        except BodyError:
            is_object = False
        if not is_object:
            self.wrong(
                node, "map:content must be the JSON of a message: an object, such as {}", content, mapping.content
            )
        command = StopCommand(_full(service, path) if service else None, _full(topic, path) if topic else None, content)
        return MappedStop(command, self.when(node, mapping.atRestWhen))

    def when(self, node: Term, predicate: NamedNode) -> tuple[Condition, ...]:
        """Return the conditions of a node."""
        found = (self.conditions[each] for each in self.objects(node, predicate))
        return tuple(sorted(found, key=lambda condition: condition.iri))

    def title(self, node: Term) -> str | None:
        """Return the rdfs:label, in English or without a language if there are several."""
        labels = [each for each in self.objects(node, rdfs.label) if isinstance(each, Literal)]
        rank = {None: 0, "en": 1}
        return min(
            ((rank.get(one.language, 2), one.language or "", one.value) for one in labels), default=(0, "", None)
        )[2]

    # Violations

    def wrong(
        self,
        node: Term | str | None,
        message: str,
        value: object = None,
        predicate: NamedNode | None = None,
        component: NamedNode | None = None,
    ) -> None:
        """Add a violation for a predicate of a node, for the node itself, or (None) for the whole document."""
        place = "" if node is None else self.places.of(node, predicate)
        focus = node if isinstance(node, Node) else NamedNode(self.url)
        self.found[Violation(place, message, brief(value), component, None, focus, predicate)] = None

    def refuse(self) -> None:
        """Raise InvalidMapping if there are violations."""
        if self.found:
            violations = sorted(self.found, key=lambda one: (one.path, one.message, one.value or ""))
            raise InvalidMapping(*violations[:_MAX_VIOLATIONS])

    def check_terms(self) -> None:
        """Check that no term of `map:` or SHACL is misspelt: an unknown term would be ignored silently."""
        for subject, predicate, object in self.triples:
            for term in (predicate, object):
                if isinstance(term, NamedNode) and _unknown(term):
                    self.wrong(subject, _no_term(term), None, predicate)

    def check_demands(self) -> None:
        """Check that every condition and each of its property shapes has a constraint, as otherwise it always holds."""
        waiting = [node for node, own in self.statements.items() if mapping.about in own]
        seen = set(waiting)
        while waiting:
            shape = waiting.pop()
            own = self.statements.get(shape, {})
            inner = own.get(sh.property, [])
            if not inner and not any(term.value.startswith(sh.iri) and term not in _NEUTRAL for term in own):
                what = "this property shape" if sh.path in own else "this shape"
                self.wrong(shape, f"{what} has no constraints, so it would always hold: add a constraint")
            waiting += [each for each in inner if each not in seen]
            seen.update(inner)

    def check_conditions(self) -> None:
        """Check that every condition can be evaluated, and parsed in time."""
        graph = ShapesGraph(self.triples)
        deadline = monotonic() + LONGEST_READING
        for node, own in self.statements.items():
            if mapping.about not in own:
                continue
            if monotonic() > deadline:
                self.wrong(node, "the conditions before this one are too large: use fewer or simpler ones")
                return
            assert isinstance(node, NamedNode)
            try:
                shape = compile_shape(graph, node)
            except ValueError as error:
                self.wrong(node, f"the condition cannot be judged: {error}")
                continue
            self.conditions[node] = Condition(node.value, self.text(node, mapping.about), shape)

    def check_names(self, resource: ComplexResource) -> None:
        """Check that names and predicates are unique within a complex resource."""
        node = NamedNode(resource.iri)
        names = [one.name for one in resource.properties] + [one.name for one in resource.actions]
        for name in _twice(names):
            self.wrong(node, f"the name {name!r} occurs twice; give one of them another map:name", name)
        for predicate in _twice([one.predicate for one in resource.properties]):
            words = f"two properties have the predicate {prefixed_name(predicate.value)[0]}; give each its own"
            self.wrong(node, words, None, mapping.property)

    def check_paths(self, resources: Sequence[ComplexResource]) -> None:
        """Check that the paths of complex resources are unique."""
        for path in _twice([one.path for one in resources]):
            first, *others = [NamedNode(one.iri) for one in resources if one.path == path]
            for other in others:
                words = f"{self.places.of(first)} already has this path; give each its own, or merge them"
                self.wrong(other, words, path, mapping.path)

    def check_sights(self, resources: Sequence[ComplexResource]) -> None:
        """Check that every condition is about a resource of this document: otherwise it would never hold."""
        states = {one.path: {each.predicate for each in one.properties} for one in resources}
        for node, condition in self.conditions.items():
            about = condition.about
            there = states.get(about) if about.endswith("/") else {rdf.value}
            if there is None or condition.shape.paths is None:
                continue
            for path in sorted(condition.shape.paths - there, key=str):
                self.wrong(
                    node,
                    f"the state of {about} has no {prefixed_name(path.value)[0]}, so this can never hold; it has "
                    + (", ".join(sorted(prefixed_name(each.value)[0] for each in there)) or "no properties"),
                )

    # Statements

    def objects(self, node: Term, predicate: NamedNode) -> Sequence[Term]:
        """Return the objects of a predicate."""
        return self.statements.get(node, {}).get(predicate, ())

    def text(self, node: Term, predicate: NamedNode) -> str:
        """Return the single string, or ""."""
        return next((each.value for each in self.objects(node, predicate) if isinstance(each, Literal)), "")

    def iri(self, node: Term, predicate: NamedNode) -> NamedNode | None:
        """Return the single IRI, or None."""
        return next((each for each in self.objects(node, predicate) if isinstance(each, NamedNode)), None)

    def relation(self, node: Term, predicate: NamedNode) -> NamedNode:
        """Return the single IRI of a relation, if there is one."""
        found = self.iri(node, predicate)
        assert found is not None
        return found


class _Places:
    """Descriptions of places in a document: `<#aircraft> map:action "start" map:service`."""

    def __init__(self, url: str, triples: Iterable[Triple], statements: Mapping[Term, Statements]) -> None:
        self._url = url
        self._statements = statements
        self._above: dict[Term, tuple[Term, NamedNode]] = {}
        for subject, predicate, object in triples:
            if isinstance(object, BlankNode):
                self._above.setdefault(object, (subject, predicate))

    def of(self, node: Term | str, predicate: NamedNode | None = None) -> str:
        """Return the description of a predicate of a node, or of the node itself."""
        steps = [] if predicate is None else [prefixed_name(predicate.value)[0]]
        passed: set[Term] = set()
        while isinstance(node, BlankNode) and node in self._above and node not in passed:
            passed.add(node)
            above, leading = self._above[node]
            steps += [self._distinguishing_text(node), prefixed_name(leading.value)[0]]
            node = above
        return " ".join(step for step in (self._name(node), *reversed(steps)) if step)

    def _name(self, node: Term | str) -> str:
        if not isinstance(node, NamedNode):
            return "[]" if isinstance(node, BlankNode) else f'"{node}"'
        if node.value.startswith(f"{self._url}#"):
            return f"<{node.value.removeprefix(self._url)}>"
        return prefixed_name(node.value)[0]

    def _distinguishing_text(self, node: BlankNode) -> str:
        """Return the text that distinguishes a blank node from its siblings, or ""."""
        own = self._statements.get(node, {})
        telling = (each for predicate in _TELLING for each in own.get(predicate, ()) if isinstance(each, Literal))
        first = next(telling, None)
        return "" if first is None else f'"{first.value}"'


def _order_of_stop(stop: MappedStop) -> tuple[bool, str, str, str]:
    command = stop.command
    return command.service is None, command.service or "", command.topic or "", command.content


def _full(name: str, path: str) -> str:
    """Return an absolute name, or one relative to the path."""
    return name if name.startswith("/") else path + name


def _twice(values: Collection[_T]) -> list[_T]:
    return [value for value, number in Counter(values).items() if number > 1]


def _unknown(term: NamedNode) -> bool:
    """Whether a term has the namespace of `map:` or SHACL but does not exist there."""
    if term.value.startswith(mapping.iri):
        return term not in _TERMS
    if not term.value.startswith(sh.iri):
        return False
    from rdflib.namespace import SH  # as in `rosld.shapes.terms`

    return term.value not in SH


def _no_term(term: NamedNode) -> str:
    from rdflib.namespace import SH

    known = [each.value for each in _TERMS] if term.value.startswith(mapping.iri) else [str(each) for each in dir(SH)]
    close = get_close_matches(term.value, known, 1)
    hint = f"; {prefixed_name(close[0])[0]} does" if close else ""
    return f"{prefixed_name(term.value)[0]} does not exist{hint}"
