"""Redaction of an RDF document: remove the triples about resources that the agent may not read.

Removed are triples that mention a URL of this server which the agent may not read, affordances of which it may not use
any form, and the blank nodes and fragments that only removed triples led to. Every triple that is left is one of the
document's own, so that it is as true as it was; only lists are closed over the members they lost, and a value that
cannot be read from something hidden is said to be unreadable without the reason.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import TypeAlias
from urllib.parse import unquote

from pyoxigraph import BlankNode, Literal, NamedNode, Triple

from rosld.ontology.document import Document, LiftedMessage
from rosld.ontology.vocab import hctl, htv, mapping, rdf, ros, td
from rosld.server.auth.errors import WITHHELD
from rosld.server.auth.permissions import Permissions

_Term: TypeAlias = "NamedNode | BlankNode | Literal | Triple"

_ABOUT = frozenset({ros.shows, ros.touches})
"""Predicates by which a part of a document says what it is about: a step of a stop, a panel of a cockpit."""
_NAMES = frozenset({ros.recordsTopic, ros.silentTopic})
"""Predicates of recordings whose values are names of topics, or globs."""
_WORDS = frozenset({ros.recordingProblem, ros.triggerCondition})
"""Predicates of an order whose words may name what it records, or waits for."""
_REASONS = frozenset({ros.unreadable, ros.words})
"""Predicates of a value that say why it cannot be read, and so name what it is read from."""
_WITHHELD = Literal(WITHHELD)
_TELLING = frozenset({ros.mappingWarning})
"""Predicates whose words name whatever there is: only who may read everything is told them."""


def redact_document(document: Document, permissions: Permissions) -> Document:
    """Return the document without what the agent may not read; the agent may read what the document is about."""
    if permissions.is_unrestricted:
        return document
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
        """Whether documents may be read, by URL: a page of 100 recorded messages names each some 50 times."""
        self._names = frozenset(self._hidden_names())

    def triples(self) -> list[Triple]:
        """Return the triples that the agent may read."""
        before = self._document.triples
        parts = self._hidden_parts()
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
                or (each.predicate in _TELLING and not self._permissions.may_read_all)
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
        """Return a message as the agent may read it; None where its own URL has a name that it may not know."""
        envelope = message.envelope
        if envelope is None or envelope.publisher is None or self._permissions.may_read(envelope.publisher):
            return message
        if self._is_named_after_hidden(self._own + message.node):
            return None
        return replace(message, envelope=envelope._replace(publisher=None))

    def _hidden_names(self) -> Iterable[str]:
        """Yield the paths of the hidden URLs that the document mentions: fragments may be named after them."""
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
        """Return the fragments and blank nodes that are about something hidden, such as the steps of a stop."""
        return frozenset(
            each.subject
            for each in self._document.triples
            if each.predicate in _ABOUT and _is_part(each.subject, self._own) and self._is_hidden(each.object)
        )

    def _values_read_from_hidden(self) -> frozenset[_Term]:
        """Return the properties that are read from something hidden."""
        return frozenset(
            each.subject
            for each in self._document.triples
            if each.predicate == ros.readsFrom and self._is_hidden(each.object)
        )

    def _orders_of_hidden(self) -> frozenset[_Term]:
        """Return the recordings that are ordered of hidden topics, or by a trigger about something hidden."""
        return frozenset(
            each.subject
            for each in self._document.triples
            if (each.predicate == ros.recordsTopic and self._is_hidden_topic(each.object))
            or (each.predicate == ros.triggerResource and self._is_hidden(each.object))
        )

    def _is_hidden_topic(self, term: _Term) -> bool:
        """Whether a literal is the name of a topic, or a glob that is spelt as one, that the agent may not read."""
        return isinstance(term, Literal) and not self._permissions.may_read_topic(term.value)

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
        """Remove forms that may not be used, affordances that have none left, and the values that these are about.

        Forms are judged as the whole document has them: that a target is hidden is what makes a form unusable.
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
        said = self._document.triples
        methods = {each.subject: each.object.value for each in said if each.predicate == htv.methodName and
                   isinstance(each.object, Literal)}  # fmt: skip
        targets = {each.subject: each.object.value.partition("{")[0] for each in said
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
    """Close lists over the members that were removed from them."""
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
    """Remove the blank nodes and fragments to which triples led before and none does any more."""
    led = {each.object for each in before if _is_part(each.object, own)}
    while True:
        leads = {each.object for each in after if each.object in led and each.subject != each.object}
        lost = led - leads
        kept = [each for each in after if each.subject not in lost]
        if len(kept) == len(after):
            return kept
        after = kept


def _is_part(term: _Term, own: str) -> bool:
    """Whether a term is reached from other nodes of the document only: a blank node or a fragment."""
    return isinstance(term, BlankNode) or (isinstance(term, NamedNode) and term.value.startswith(f"{own}#"))
