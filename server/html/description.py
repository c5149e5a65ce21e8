"""The description of a document as sections of rows, its main resource first."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

from msgspec import Struct, field
from pyoxigraph import BlankNode, Literal, NamedNode

from rosld.ontology.document import Document
from rosld.ontology.outline import Outline, Statements, Subject, outline
from rosld.ontology.vocab import av, dcterms, ldp, mapping, rdf, rdfs, ros
from rosld.server.html.labels import label, local_name
from rosld.server.html.page import Term
from rosld.server.html.site import Site
from rosld.server.html.values import term_view
from rosld.server.html.view import TableListView, TableRow, TableView, View, escape_controls

_DEEPEST = 12
_FIRST = (
    rdf.type, ros.name, rdfs.label, rdfs.comment, ros.state, ros.staleSince, ros.reason, ros.status,
    ros.lifecycleState, ros.lifecycleStateWord, ros.lifecycleUnknown, ros.unreachable, ros.unreadable, ros.uncallable,
    ros.unusable, ros.value, ros.hasMessageType, ros.hasServiceType, ros.hasActionType, ros.conflictingType, ros.rate,
    ros.hasQosMismatch, ros.publishedBy, ros.subscribedBy, ros.provider, ros.publishes, ros.subscribes, ros.provides,
    ros.sendsGoalsTo, ros.hasParameter, ros.fieldName, ros.fieldType, ros.nestedType,
)  # fmt: skip
_RANK = {predicate: rank for rank, predicate in enumerate(_FIRST)}
_LAST = {ros.definition: 1_000, ros.hasField: 999, rdfs.isDefinedBy: 998}
_QUIET_TYPES = frozenset({ldp.Resource, ldp.RDFSource, ldp.Container})


class Section(Struct, frozen=True):
    """A subject of the document and its statements. `id` is its fragment on the page, `kind` its type in words."""

    title: str
    body: TableView
    id: str = ""
    kind: str = ""


class _Walk(Struct):
    """State of a traversal of a document: `visited` are the subjects placed, `left` is the number of rows left."""

    outline: Outline
    site: Site
    url: str
    parts: tuple[str, ...]
    visited: set[Subject] = field(default_factory=set)
    left: int = 4_000


def describe(
    document: Document, site: Site, *, without: Iterable[NamedNode] = (), apart: Iterable[NamedNode] = ()
) -> tuple[Section, ...]:
    """Return the sections of a document.

    `without` are predicates of the main resource that the page shows elsewhere, along with their objects; `apart` are
    other subjects that it shows elsewhere.
    """
    found = outline(document.triples)
    main = main_subject(document, found)
    about = main.value if isinstance(main, NamedNode) else document.url
    walk = _Walk(found, site, document.url, (f"{document.url}#", f"{about}#"))
    skipped = frozenset(without)
    sections: list[Section] = []
    own = walk.outline.subjects.get(main)
    if own is not None:
        walk.visited.add(main)
        rows = _rows(walk, {predicate: own[predicate] for predicate in own if predicate not in skipped}, 0)
        sections.append(Section("Description", TableView(rows)))
    hidden = _shown_elsewhere(found, main, skipped) | set(apart)
    sections.extend(_others(walk, hidden))
    return tuple(section for section in sections if section.body.rows)


def main_subject(document: Document, found: Outline) -> Subject:
    """Return the main subject of a document: the resource at its URL, or else the first subject."""
    own = NamedNode(document.url)
    if own in found.subjects:
        return own
    return next((subject for subject in found.subjects if isinstance(subject, NamedNode)), own)


def _shown_elsewhere(found: Outline, main: Subject, skipped: frozenset[NamedNode]) -> set[Subject]:
    """Return the objects of these predicates and the parts of those objects."""
    own = found.subjects.get(main, {})
    left = [term for predicate in skipped for term in own.get(predicate, ()) if isinstance(term, NamedNode | BlankNode)]
    hidden: set[Subject] = set()
    while left:
        term = left.pop()
        if term in hidden or term == main:
            continue
        hidden.add(term)
        for terms in found.subjects.get(term, {}).values():
            left += [one for one in terms if isinstance(one, NamedNode | BlankNode) and _is_part(one)]
    return hidden


def _is_part(term: Subject) -> bool:
    """Whether a term is a part of another resource, without a URL of its own."""
    return isinstance(term, BlankNode) or "#" in term.value


def _others(walk: _Walk, hidden: set[Subject]) -> Iterator[Section]:
    for subject in walk.outline.subjects:
        if subject in walk.visited or subject in hidden or subject in walk.outline.cells:
            continue
        if isinstance(subject, BlankNode) and subject in walk.outline.nested:
            continue
        walk.visited.add(subject)
        if walk.outline.subjects[subject].keys() == {rdfs.isDefinedBy}:
            continue  # a class of messages: every link to it leads there
        body = TableView(_rows(walk, walk.outline.subjects[subject], 0))
        yield Section(_title(walk, subject), body, fragment(subject, walk.url), _kind(walk.outline.subjects[subject]))


def _kind(statements: Statements) -> str:
    """Return the words for the first informative type of a subject."""
    types = _order_types(rdf.type, statements.get(rdf.type, []))
    return label(types[0].value) if types and isinstance(types[0], NamedNode) else ""


def _title(walk: _Walk, subject: Subject) -> str:
    if isinstance(subject, BlankNode):
        return "Something without a name"
    if subject.value.startswith(f"{walk.url}#"):
        return escape_controls(local_name(subject.value))
    return escape_controls(walk.site.short_name(subject.value))


def fragment(subject: Subject, url: str) -> str:
    """Return the id of a subject's section: the fragment of its IRI if that is on this page or in the vocabulary."""
    if isinstance(subject, BlankNode) or "#" not in subject.value:
        return ""
    if subject.value.startswith((f"{url}#", ros.iri, mapping.iri, av.iri)):
        return escape_controls(subject.value.partition("#")[2])
    return ""


def _rows(walk: _Walk, statements: Statements, depth: int) -> tuple[TableRow, ...]:
    rows: list[TableRow] = []
    shown = [*statements.get(ros.name, ()), *statements.get(dcterms.title, ())]
    for predicate in sorted(statements, key=_rank):
        if walk.left <= 0:
            break
        if predicate == rdfs.label and all(term in shown for term in statements[predicate]):
            continue
        terms = _order_types(predicate, statements[predicate])
        walk.left -= len(terms)
        rows.append(_row(walk, predicate, terms, depth))
    return tuple(rows)


def _rank(predicate: NamedNode) -> tuple[int, str]:
    return (_RANK.get(predicate, _LAST.get(predicate, len(_RANK))), label(predicate.value))


def _order_types(predicate: NamedNode, terms: list[Term]) -> list[Term]:
    """Return types with the informative ones before those of LDP, and other terms unchanged."""
    if predicate != rdf.type:
        return terms
    return sorted(terms, key=lambda term: term in _QUIET_TYPES)


def _row(walk: _Walk, predicate: NamedNode, terms: list[Term], depth: int) -> TableRow:
    views = tuple(_view(walk, term, depth) for term in terms)
    tables = tuple(view for view in views if isinstance(view, TableView))
    if len(tables) > 1 and len(tables) == len(views):
        views = (TableListView(len(tables), tables),)
    name = "type" if predicate == rdf.type else label(predicate.value)
    return TableRow(name, views, about=_about(walk.site, predicate), term=walk.site.anchor(predicate.value))


def _about(site: Site, predicate: NamedNode) -> str:
    return escape_controls(site.prefixed_name(predicate.value))


def _view(walk: _Walk, term: Term, depth: int) -> View:
    if isinstance(term, BlankNode) and term in walk.outline.lists:
        return _list(walk, walk.outline.lists[term], depth)
    if isinstance(term, NamedNode | BlankNode) and _nests(walk, term, depth):
        walk.visited.add(term)
        rows = _rows(walk, walk.outline.subjects[term], depth + 1)
        return TableView(rows, id="" if isinstance(term, BlankNode) else fragment(term, walk.url))
    return term_view(term, walk.site, walk.url)


def _nests(walk: _Walk, term: Subject, depth: int) -> bool:
    """Whether to nest a subject: a blank node used once, or a part of the main subject not drawn before."""
    if depth >= _DEEPEST or term in walk.visited or term not in walk.outline.subjects:
        return False
    if isinstance(term, BlankNode):
        return term in walk.outline.nested
    return term.value.startswith(walk.parts)


def _list(walk: _Walk, terms: list[Term], depth: int) -> View:
    if depth >= _DEEPEST:
        return TableListView(len(terms), ())
    views = [_view(walk, term, depth + 1) for term in terms]
    tables = tuple(
        view if isinstance(view, TableView) else TableView((TableRow(str(index), (view,)),))
        for index, view in enumerate(views)
    )
    return TableListView(len(terms), tables)


def objects_of(document: Document, predicate: NamedNode) -> list[Term]:
    """Return the objects of `predicate` for the resource at the document's URL."""
    own = NamedNode(document.url)
    return [triple.object for triple in document.triples if triple.subject == own and triple.predicate == predicate]


def first_text(document: Document, predicate: NamedNode) -> str:
    """Return the first literal of `predicate` for the resource at the document's URL, or an empty text."""
    found = (term.value for term in objects_of(document, predicate) if isinstance(term, Literal))
    return escape_controls(next(found, ""))


MAX_SECTIONS = 40
"""Maximum number of sections in a plain list; more are folded by kind."""


def group_sections(sections: Sequence[Section]) -> tuple[tuple[str, Sequence[Section]], ...]:
    """Return the kinds with their sections, in order of first appearance; empty if there are few."""
    if len(sections) <= MAX_SECTIONS:
        return ()
    kinds: dict[str, list[Section]] = {}
    for section in sections:
        kinds.setdefault(section.kind or "others", []).append(section)
    return tuple(kinds.items())
