"""Redaction: removal of everything from responses that the requesting agent may not read.

All functions are pure, and take the content first and then the agent's permissions. States (`rest/state.py`) and views
(`hypermedia/views.py`) use them to redact themselves; the OpenAPI description contains only permitted operations
(`openapi/description_parts.py`), and SPARQL queries a redacted dataset (`sparql/restricted.py`).
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from copy import copy
from functools import lru_cache
from typing import TypeAlias
from urllib.parse import unquote, urljoin

import orjson
from msgspec.structs import replace
from pyoxigraph import BlankNode, Literal, NamedNode, Triple

from rosld.ontology.document import Document, LiftedMessage
from rosld.ontology.urls import Location, encode_segment
from rosld.ontology.violations import Violation
from rosld.ontology.vocab import dcat, hctl, htv, mapping, rdf, ros, td
from rosld.server.auth.errors import WITHHELD, gone, not_found, withhold_reason
from rosld.server.auth.permissions import Permissions
from rosld.server.http.fields import parse_links, render_links
from rosld.server.http.problem import Problem

_Term: TypeAlias = "NamedNode | BlankNode | Literal | Triple"

_ABOUT = frozenset({ros.shows, ros.touches})
"""Predicates from a part of a document to its subject: a step of a stop, a panel of a cockpit."""
_NAMES = frozenset({ros.recordsTopic, ros.silentTopic, dcat.keyword})
"""Predicates of recordings whose values are topic names or globs."""
_WORDS = frozenset({ros.recordingProblem, ros.triggerCondition})
"""Predicates of an order whose text may mention its recorded topics, or its trigger."""
_REASONS = frozenset({ros.unreadable, ros.words})
"""Predicates of a value with the reason why it cannot be read, which may mention its source."""
_WITHHELD = Literal(WITHHELD)
_UNBOUNDED = frozenset({ros.mappingWarning})
"""Predicates whose text may mention anything: only agents that may read everything get them."""


def redact_document(document: Document, permissions: Permissions) -> Document:
    """Return the document without what the agent may not read; the agent may read what the document is about."""
    if permissions.is_unrestricted:
        return document
    if (own := permissions.within(document.url)) is not permissions:
        document = redact_document(document, own)
    redaction = _Redaction(document, permissions)
    triples = redaction.triples()
    messages = tuple(each for message in document.messages if (each := redaction.message(message)) is not None)
    parts = tuple(redact_document(part, permissions) for part in document.parts if permissions.may_read(part.url))
    return replace(document, triples=tuple(triples), messages=messages, parts=parts)


class _Redaction:
    """The redaction of one document for one agent."""

    def __init__(self, document: Document, permissions: Permissions) -> None:
        self._document = document
        self._permissions = permissions
        self._own = document.url.partition("?")[0].partition("#")[0]
        self._judged: dict[str, bool] = {}
        """Permissions to read documents, by URL: a page of 100 recorded messages mentions each some 50 times."""
        self._names = frozenset(self._hidden_names())

    def triples(self) -> list[Triple]:
        before = self._document.triples
        parts = self._hidden_parts()
        if NamedNode(self._own) in parts:
            return []
        orders = self._orders_of_hidden()
        unreadable = self._values_read_from_hidden()
        after = [
            each
            for each in before
            if not (
                self._is_hidden(each.subject)
                or self._is_hidden(each.object)
                or each.subject in parts
                or each.object in parts
                or (each.predicate in _NAMES and self._is_hidden_topic(each.object))
                or (each.predicate in _WORDS and each.subject in orders)
                or (each.predicate in _UNBOUNDED and not self._permissions.may_read_all)
                or (each.predicate in _REASONS and each.subject in unreadable)
            )
        ]
        after += [
            Triple(each.subject, each.predicate, _WITHHELD)
            for each in before
            if each.predicate == ros.unreadable and each.subject in unreadable and not self._is_hidden(each.subject)
        ]
        after = self._remove_unusable_forms(after)
        if len(after) == len(before):
            return after
        return _remove_orphans(_close_lists(before, after), before, self._own)

    def message(self, message: LiftedMessage) -> LiftedMessage | None:
        """Return a message without a hidden publisher, None if its own URL contains a hidden name."""
        envelope = message.envelope
        if envelope is None or envelope.publisher is None or self._permissions.may_read(envelope.publisher):
            return message
        if self._is_named_after_hidden(self._own + message.node):
            return None
        return replace(message, envelope=envelope._replace(publisher=None))

    def _hidden_names(self) -> Iterable[str]:
        """Yield the paths of hidden URLs in the document: fragments may be named after them."""
        urls = {
            term.value
            for triple in self._document.triples
            for term in (triple.subject, triple.object)
            if isinstance(term, NamedNode)
        }
        urls |= {one.envelope.publisher for one in self._document.messages if one.envelope and one.envelope.publisher}
        for url in urls:
            place = self._permissions.locate(url)
            if place is not None and place.segments and not self._may_read(url):
                yield "/" + "/".join(place.segments)

    def _hidden_parts(self) -> frozenset[_Term]:
        """Return the fragments and blank nodes that are about something hidden, such as the steps of a stop.

        A body is hidden as a whole if one of its descriptions is.
        """
        return frozenset(
            each.subject
            for each in self._document.triples
            if (each.predicate == ros.describedBy or (each.predicate in _ABOUT and _is_part(each.subject, self._own)))
            and self._is_hidden(each.object)
        )

    def _values_read_from_hidden(self) -> frozenset[_Term]:
        """Return the properties that are read from something hidden."""
        return frozenset(
            each.subject
            for each in self._document.triples
            if each.predicate == ros.readsFrom and self._is_hidden(each.object)
        )

    def _orders_of_hidden(self) -> frozenset[_Term]:
        """Return the recordings ordered of hidden topics, or with a hidden trigger."""
        return frozenset(
            each.subject
            for each in self._document.triples
            if (each.predicate == ros.recordsTopic and self._is_hidden_topic(each.object))
            or (each.predicate == ros.triggerResource and self._is_hidden(each.object))
        )

    def _is_hidden_topic(self, term: _Term) -> bool:
        """Whether a literal is a topic name (or a glob treated as one) that the agent may not read."""
        if not isinstance(term, Literal) or not term.value.startswith(("/", "*")):  # a tag is no name
            return False
        return not self._permissions.may_read_topic(term.value)

    def _is_hidden(self, term: _Term) -> bool:
        if not isinstance(term, NamedNode):
            return False
        url = term.value
        if url.partition("#")[0].partition("?")[0] == self._own:
            return ("?" in url and not self._may_read(url)) or self._is_named_after_hidden(url)
        return not self._may_read(url)

    def _may_read(self, url: str) -> bool:
        document = url.partition("#")[0]
        found = self._judged.get(document)
        if found is None:
            found = self._judged[document] = self._permissions.may_read(document)
        return found

    def _is_named_after_hidden(self, url: str) -> bool:
        """Whether a URL ends in a fragment named after something hidden (`#from/talker`)."""
        fragment = url.partition("#")[2].partition(";")[0]
        return bool(self._names) and "/" in fragment and unquote(fragment).endswith(tuple(self._names))

    def _remove_unusable_forms(self, triples: list[Triple]) -> list[Triple]:
        """Remove forms that may not be used, affordances without any form left, and their values.

        Forms are judged by the original document: a hidden target makes a form unusable.
        """
        usable = self._usable_forms()
        dropped: set[_Term] = set()
        values: set[_Term] = set()
        for affordance, (forms, predicate) in self._affordances().items():
            left = forms & usable.keys()
            dropped |= forms - left
            if not left and (forms or predicate is not None):
                dropped.add(affordance)
            if predicate is not None and "GET" not in map(usable.get, left):
                values.add(predicate)
        return [
            each
            for each in triples
            if each.subject not in dropped
            and each.object not in dropped
            and not (each.predicate in values and each.subject == NamedNode(self._document.url))
        ]

    def _usable_forms(self) -> dict[_Term, str]:
        """Return the method of each form that the agent may use, by the form's node."""
        triples = self._document.triples
        methods = {each.subject: each.object.value for each in triples if each.predicate == htv.methodName and
                   isinstance(each.object, Literal)}  # fmt: skip
        targets = {each.subject: each.object.value.partition("{")[0] for each in triples
                   if each.predicate == hctl.hasTarget and isinstance(each.object, NamedNode | Literal)}  # fmt: skip
        return {
            form: method
            for form, url in targets.items()
            if self._permissions.may(method := methods.get(form, "GET"), url)
        }

    def _affordances(self) -> dict[_Term, tuple[set[_Term], _Term | None]]:
        """Return the forms of each affordance, and the predicate by which this document states its value, if any."""
        stated = {each.predicate for each in self._document.triples if each.subject == NamedNode(self._document.url)}
        found: dict[_Term, tuple[set[_Term], _Term | None]] = {}
        for each in self._document.triples:
            if each.predicate == td.hasForm:
                found.setdefault(each.subject, (set(), None))[0].add(each.object)
            elif each.predicate == mapping.predicate and each.object in stated:
                found[each.subject] = (found.get(each.subject, (set(), None))[0], each.object)
        return found


def _close_lists(before: Iterable[Triple], after: list[Triple]) -> list[Triple]:
    """Relink lists around removed members."""
    firsts = {each.subject for each in after if each.predicate == rdf.first}
    broken = {each.subject for each in before if each.predicate == rdf.first} - firsts
    if not broken:
        return after
    rests = {each.subject: each.object for each in before if each.predicate == rdf.rest}

    def beyond(term: _Term) -> _Term:
        while term in broken and isinstance(term, NamedNode | BlankNode):
            term = rests.get(term, rdf.nil)
        return term

    return [Triple(each.subject, each.predicate, beyond(each.object)) for each in after if each.subject not in broken]


def _remove_orphans(after: list[Triple], before: Iterable[Triple], own: str) -> list[Triple]:
    """Remove blank nodes and fragments that triples referenced before, but no longer do."""
    led = {each.object for each in before if _is_part(each.object, own)}
    while True:
        leads = {each.object for each in after if each.object in led and each.subject != each.object}
        lost = led - leads
        remaining = [each for each in after if each.subject not in lost]
        if len(remaining) == len(after):
            return remaining
        after = remaining


def _is_part(term: _Term, own: str) -> bool:
    """Whether a term is only reachable from other nodes of the document: a blank node or a fragment."""
    return isinstance(term, BlankNode) or (isinstance(term, NamedNode) and term.value.startswith(f"{own}#"))


def redact_link_field(field: str, permissions: Permissions) -> str:
    """Return a Link field without links to hidden resources, empty if none is left."""
    if permissions.is_unrestricted:
        return field
    # With types in the rights, the result may change between requests.
    return (
        _redact_links(field, permissions) if permissions.rights.is_typed else _redact_links_cached(field, permissions)
    )


def _redact_links(field: str, permissions: Permissions) -> str:
    return render_links(each for each in parse_links(field) if permissions.may_read(each.target))


_redact_links_cached = lru_cache(maxsize=4096)(_redact_links)


_OFFERED_METHODS = frozenset({"allow", "accept-put", "accept-post", "accept-patch"})
"""Fields of a 404 or 410 with the methods that create the resource."""


def redact_problem(problem: Problem, permissions: Permissions, place: Location | None) -> Problem:
    """Remove from a problem about `place` what the agent may not see.

    A 410 becomes a 404 unless the agent may know of any type there, and so does a redirect to a hidden Location.
    Reasons that mention other hidden resources are removed, and so are the IRIs of hidden shapes.
    """
    if permissions.is_unrestricted:
        return problem
    if problem.status in (404, 410):
        return _redact_absence(problem, permissions, place)
    if not all(permissions.may_read(url) or permissions.locate(url) == place for url in problem.about):
        return withhold_reason(problem)
    violations = tuple(_redact_violation(each, permissions) for each in problem.violations)
    if violations != problem.violations:
        problem = copy(problem)  # the instance may be shared
        problem.violations = violations
    target = problem.headers.get("Location")
    if target is not None and problem.status < 400 and not permissions.may_read(target):
        return not_found()
    return problem


def _redact_violation(violation: Violation, permissions: Permissions) -> Violation:
    shape = violation.shape
    is_hidden = isinstance(shape, NamedNode) and not permissions.may_read(shape.value)
    return replace(violation, shape=None) if is_hidden else violation


def _redact_absence(problem: Problem, permissions: Permissions, place: Location | None) -> Problem:
    if place is None or not permissions.may_know_any_type(place):
        return not_found()
    if permissions.may_read_all:
        return problem
    found = gone() if problem.status == 410 else not_found()
    found.headers |= {name: value for name, value in problem.headers.items() if name.lower() in _OFFERED_METHODS}
    return found


_BEARER: Mapping[str, str] = {"scheme": "bearer", "in": "header", "format": "opaque"}
_BASIC: Mapping[str, str] = {"scheme": "basic", "in": "header"}


def redact_thing_description(data: bytes, permissions: Permissions, scheme: str = "") -> bytes:
    """Return a description with only the forms that the agent may use, their affordances, and a security scheme.

    It is `scheme`, by which the request was authenticated, if that is basic, else bearer: clients cannot choose.
    """
    thing = orjson.loads(data)
    base = thing["id"]
    name, stated = ("basic_sc", _BASIC) if scheme.lower() == "basic" else ("bearer_sc", _BEARER)
    thing["securityDefinitions"], thing["security"] = {name: stated}, [name]
    if permissions.is_unrestricted:
        return orjson.dumps(thing)

    def usable(forms: list[dict[str, str]]) -> list[dict[str, str]]:
        return [
            one
            for one in forms
            if permissions.may(one.get("htv:methodName", "GET"), urljoin(base, one["href"].partition("{?")[0]))
        ]

    for kind in ("properties", "actions", "events"):
        if kind not in thing:
            continue
        left = {name: {**one, "forms": usable(one["forms"])} for name, one in thing[kind].items()}
        thing[kind] = {name: one for name, one in left.items() if one["forms"]}
    if "forms" in thing:
        thing["forms"] = usable(thing["forms"])
        if not thing["forms"]:
            del thing["forms"]
    thing["links"] = [one for one in thing.get("links", ()) if permissions.may_read(urljoin(base, one["href"]))]
    return orjson.dumps(thing)


def redact_tree(data: bytes, url: str, permissions: Permissions) -> bytes:
    """Return the JSON object of a container without the unreadable members, at any depth."""

    def redact(value: object, at: str) -> object:
        if not isinstance(value, dict):
            return value
        ends = {key: encode_segment(key) + ("/" if isinstance(inner, dict) else "") for key, inner in value.items()}
        return {key: redact(value[key], at + end) for key, end in ends.items() if permissions.may_read(at + end)}

    return json.dumps(redact(json.loads(data), url), ensure_ascii=False, separators=(",", ":")).encode()
