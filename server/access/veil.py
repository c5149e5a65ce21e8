"""The veil: what a document says to one who may not read everything it speaks of. Pure.

Left out are triples that mention a URL of this server which the agent may not read, affordances of which they may not
use any form, and whatever hung on what was left out and on nothing else. What is left is as true as it was.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import TypeAlias
from urllib.parse import unquote

from pyoxigraph import BlankNode, Literal, NamedNode, Triple

from rosld.ontology.document import Document, LiftedMessage
from rosld.ontology.vocab import hctl, htv, rdf, td
from rosld.server.access.judge import Judge

_Term: TypeAlias = "NamedNode | BlankNode | Literal | Triple"


def veiled(document: Document, judge: Judge) -> Document:
    """The document as an agent with these rights may read it; it may read what the document is about."""
    if judge.whole:
        return document
    seen = _Veil(document, judge)
    triples = seen.triples()
    messages = tuple(each for message in document.messages if (each := seen.message(message)) is not None)
    return replace(document, triples=tuple(triples), messages=messages)


class _Veil:
    """One document, looked at by one agent."""

    def __init__(self, document: Document, judge: Judge) -> None:
        self._document = document
        self._judge = judge
        self._own = document.url.partition("?")[0].partition("#")[0]
        self._names = frozenset(self._hidden_names())

    def triples(self) -> list[Triple]:
        """The description as it may be read."""
        before = self._document.triples
        after = [triple for triple in before if not any(map(self._is_hidden, (triple.subject, triple.object)))]
        after = self._without_forms(after)
        if len(after) == len(before):
            return after
        return _without_hanging(_relinked(before, after), before, self._own)

    def message(self, message: LiftedMessage) -> LiftedMessage | None:
        """A message as it may be read; None for one that is there by the name of who may not be known."""
        envelope = message.envelope
        if envelope is None or envelope.publisher is None or self._judge.may_read(envelope.publisher):
            return message
        if self._names_hidden(self._own + message.node):
            return None
        return replace(message, envelope=envelope._replace(publisher=None))

    def _hidden_names(self) -> Iterable[str]:
        """The paths, below their rooms, of those hidden URLs by whose names fragments of this document are called."""
        urls = {
            term.value
            for triple in self._document.triples
            for term in (triple.subject, triple.object)
            if isinstance(term, NamedNode)
        }
        urls |= {one.envelope.publisher for one in self._document.messages if one.envelope and one.envelope.publisher}
        for url in urls:
            place = self._judge.place(url)
            if place is not None and place.segments and not self._judge.may_read(url):
                yield "/" + "/".join(place.segments)

    def _is_hidden(self, term: _Term) -> bool:
        if not isinstance(term, NamedNode):
            return False
        url = term.value
        if url.partition("#")[0].partition("?")[0] == self._own:
            return ("?" in url and not self._judge.may_read(url)) or self._names_hidden(url)
        return not self._judge.may_read(url)

    def _names_hidden(self, url: str) -> bool:
        """Whether a fragment of this document is called by a name that may not be known (`#from/talker`)."""
        fragment = url.partition("#")[2].partition(";")[0]
        return bool(self._names) and "/" in fragment and unquote(fragment).endswith(tuple(self._names))

    def _without_forms(self, triples: list[Triple]) -> list[Triple]:
        """Without forms that may not be used, and without affordances that had forms and have none left."""
        methods = {each.subject: each.object.value for each in triples if each.predicate == htv.methodName and
                   isinstance(each.object, Literal)}  # fmt: skip
        targets = {each.subject: each.object.value for each in triples if each.predicate == hctl.hasTarget and
                   isinstance(each.object, NamedNode)}  # fmt: skip
        gone = {form for form, url in targets.items() if not self._judge.may(methods.get(form, "GET"), url)}
        had = {each.subject for each in triples if each.predicate == td.hasForm}
        has = {each.subject for each in triples if each.predicate == td.hasForm and each.object not in gone}
        targetless = {each.object for each in self._document.triples if each.predicate == td.hasForm} - targets.keys()
        before = {each.subject for each in self._document.triples if each.predicate == td.hasForm}
        dropped = gone | (had - has) | (before - has) | {form for form in targetless if isinstance(form, NamedNode)}
        return [each for each in triples if each.subject not in dropped and each.object not in dropped]


def _relinked(before: Iterable[Triple], after: list[Triple]) -> list[Triple]:
    """With lists closed over the members that were left out of them."""
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


def _without_hanging(after: list[Triple], before: Iterable[Triple], own: str) -> list[Triple]:
    """Without what nothing leads to any more: blank nodes and fragments to which something led before."""
    led = {each.object for each in before if _is_part(each.object, own)}
    while True:
        leads = {each.object for each in after if each.object in led and each.subject != each.object}
        lost = led - leads
        kept = [each for each in after if each.subject not in lost]
        if len(kept) == len(after):
            return kept
        after = kept


def _is_part(term: _Term, own: str) -> bool:
    """Whether it is there by way of something else only."""
    return isinstance(term, BlankNode) or (isinstance(term, NamedNode) and term.value.startswith(f"{own}#"))
