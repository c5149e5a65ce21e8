"""N3 patches (Solid Protocol 5.3.1): conditions, deletions, insertions. No I/O."""

# The names of methods are those of rdflib's parser.
# ruff: noqa: N802

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import NamedTuple, NoReturn, TypeAlias

from msgspec import Struct
from pyoxigraph import BlankNode, Literal, NamedNode, Triple

from rosld.ontology.body import BodyError
from rosld.ontology.vocab import rdf
from rosld.server.http.problem import Problem
from rosld.server.rest.ros_problems import problem_of_body


class RefusedSyntax(Exception):
    """Syntax of N3 that patches do not support."""


class Variable(NamedTuple):
    """A variable by its name, without the question mark."""

    name: str

    def __str__(self) -> str:
        return f"?{self.name}"


class Formula:
    """Contents of braces, or of the document: statements in order. Equal only to itself."""

    def __init__(self) -> None:
        self.statements: list[Statement] = []
        self.existentials: dict[str, Node] = {}

    def close(self) -> Formula:
        """Return the formula itself, as a term."""
        return self

    def newUniversal(self, name: str, why: object = None) -> NoReturn:
        """Raise an error: variables are written `?name` only."""
        raise RefusedSyntax("@forAll is not supported: write ?variables")

    def declareExistential(self, name: str) -> NoReturn:
        """Raise an error: blank nodes are written `_:name` or `[]` only."""
        raise RefusedSyntax("@forSome is not supported: write blank nodes")


Node: TypeAlias = "NamedNode | BlankNode | Literal | Variable | Formula"


class Statement(NamedTuple):
    """A statement. In N3, any term can have any position."""

    subject: Node
    predicate: Node
    object: Node


MEDIA_TYPE = "text/n3"
MAX_BYTES = 256 * 1024
"""Maximum bytes of a patch; for larger changes, the whole resource is put."""
MAX_PATTERNS = 64
"""Maximum number of patterns with variables in one solid:where."""
MAX_STEPS = 100_000
"""Maximum number of steps in matching solid:where, which a hostile patch could make endless."""
_SOLID = "http://www.w3.org/ns/solid/terms#"
_PATCH = NamedNode(f"{_SOLID}InsertDeletePatch")
_WHERE, _DELETES, _INSERTS = (NamedNode(_SOLID + name) for name in ("where", "deletes", "inserts"))

Term: TypeAlias = "NamedNode | BlankNode | Literal | Triple"
Bindings: TypeAlias = Mapping[Variable, Term]


class Pattern(NamedTuple):
    """A triple, or a pattern of triples with variables."""

    subject: Term | Variable
    predicate: Term | Variable
    object: Term | Variable

    @property
    def variables(self) -> frozenset[Variable]:
        """Variables of the pattern, which a solution binds."""
        return frozenset(each for each in self if isinstance(each, Variable))

    def substitute(self, bindings: Bindings) -> Pattern:
        """Return the pattern with bound variables replaced."""
        return Pattern(*(bindings.get(each, each) if isinstance(each, Variable) else each for each in self))

    def __str__(self) -> str:
        return " ".join(map(str, self))


class N3Patch(Struct, frozen=True):
    """A patch. Blank nodes in `where` are additional variables, listed in `unnamed`."""

    where: tuple[Pattern, ...] = ()
    deletes: tuple[Pattern, ...] = ()
    inserts: tuple[Pattern, ...] = ()
    unnamed: frozenset[Variable] = frozenset()


# Reading


def read_patch(data: bytes, base: str) -> N3Patch:
    """Return the patch in a text/n3 body, with IRIs resolved against `base` and the original spelling of literals.

    Raises Problems: 413 for more than `MAX_BYTES`, 400 for invalid N3, 422 for N3 that is not a patch by Solid Protocol
    5.3.1.
    """
    if len(data) > MAX_BYTES:
        raise Problem(413, f"A patch can have at most {MAX_BYTES} bytes: PUT the whole resource instead.")
    from rosld.server.patches.n3_parser import read_n3  # imports rdflib, which many servers never need

    try:
        document = read_n3(data, base)
    except BodyError as error:
        raise problem_of_body(error) from error
    patch = _subject(document)
    where, deletes, inserts = (_formula(document, patch, name) for name in (_WHERE, _DELETES, _INSERTS))
    unnamed: dict[BlankNode, Variable] = {}
    found = N3Patch(
        tuple(_pattern(one, _WHERE, unnamed) for one in where),
        tuple(_pattern(one, _DELETES, None) for one in deletes),
        tuple(_pattern(one, _INSERTS, None) for one in inserts),
        frozenset(unnamed.values()),
    )
    _check_variables(found)
    return found


def _subject(document: Formula) -> Node:
    """Return the one patch resource of a document."""
    subjects = {
        one.subject: None
        for one in document.statements
        if one.predicate in (_WHERE, _DELETES, _INSERTS) or (one.predicate == rdf.type and one.object == _PATCH)
    }
    if len(subjects) != 1:
        raise _malformed(
            f"A patch document must have one patch, not {len(subjects)}: write `_:patch a solid:InsertDeletePatch`"
        )
    subject = next(iter(subjects))
    if not isinstance(subject, NamedNode | BlankNode):
        raise _malformed(f"A patch must be named by an IRI or a blank node, not by {_node_text(subject)}")
    if Statement(subject, rdf.type, _PATCH) not in document.statements:
        raise _malformed(f"The patch {subject} has no type: add `a solid:InsertDeletePatch`")
    return subject


def _formula(document: Formula, patch: Node, predicate: NamedNode) -> Sequence[Statement]:
    """Return the statements of the formula that is the patch's value of a predicate, or none."""
    objects = [one.object for one in document.statements if one.subject == patch and one.predicate == predicate]
    if len(objects) > 1:
        raise _malformed(f"A patch has {_name(predicate)} at most once, not {len(objects)} times")
    if not objects:
        return ()
    if not isinstance(objects[0], Formula):
        raise _malformed(f"The value of {_name(predicate)} must be a formula in braces, not {_node_text(objects[0])}")
    return objects[0].statements


def _pattern(one: Statement, place: NamedNode, unnamed: dict[BlankNode, Variable] | None) -> Pattern:
    """Return a statement as a pattern. Blank nodes become variables in `unnamed`; if that is None, raise a Problem."""
    found: list[Term | Variable] = []
    for node in one:
        if isinstance(node, Formula):
            raise _malformed(f"The formula of {_name(place)} contains another: it can contain only triples")
        if isinstance(node, BlankNode):
            if unnamed is None:
                raise _malformed(f"The formula of {_name(place)} contains a blank node: use IRIs and ?variables")
            node = unnamed.setdefault(node, Variable(f"[{len(unnamed)}]"))
        found.append(node)
    subject, predicate, _ = found
    if isinstance(subject, Literal):
        raise _malformed(
            f"{_node_text(subject)} is the subject of a triple in {_name(place)}, but a subject cannot be a literal"
        )
    if not isinstance(predicate, NamedNode | Variable):
        raise _malformed(
            f"{_node_text(predicate)} is the predicate of a triple in {_name(place)}, but a predicate must be an IRI"
        )
    return Pattern(*found)


def _check_variables(patch: N3Patch) -> None:
    known = {each for pattern in patch.where for each in pattern.variables}
    for place, patterns in ((_DELETES, patch.deletes), (_INSERTS, patch.inserts)):
        for pattern in patterns:
            if stray := sorted(map(str, pattern.variables - known)):
                raise _malformed(f"The variable {stray[0]} of {_name(place)} does not occur in solid:where")
    if sum(1 for pattern in patch.where if pattern.variables) > MAX_PATTERNS:
        raise _malformed(f"solid:where has more than {MAX_PATTERNS} patterns with variables: send several patches")


def _malformed(words: str) -> Problem:
    return Problem(422, f"{words} (Solid Protocol 5.3.1).")


def _name(predicate: NamedNode) -> str:
    return predicate.value.replace(_SOLID, "solid:")


def _node_text(node: Node | Term) -> str:
    return "a formula" if isinstance(node, Formula) else str(node)[:200]


# Applying


def apply_patch(patch: N3Patch, before: Iterable[Triple]) -> list[Triple]:
    """Return the triples after a patch: without deleted ones, with inserted ones last, otherwise unchanged.

    Terms match by spelling. Raises 409 Problems, with nothing changed, if solid:where does not match in exactly one
    way, if a deleted triple does not exist, or if an inserted one is not a valid triple.
    """
    there = dict.fromkeys(before)
    deletes, inserts = find_changes(patch, list(there))
    for triple in deletes:
        if triple not in there:
            raise missing_deletion(triple)
    deleted = frozenset(deletes)
    return list(dict.fromkeys([*(triple for triple in there if triple not in deleted), *inserts]))


def find_changes(patch: N3Patch, before: Sequence[Triple]) -> tuple[list[Triple], list[Triple]]:
    """Return the triples that a patch deletes and inserts, whether or not they exist. Only solid:where reads `before`.

    Raises 409 Problems like `apply_patch`.
    """
    bindings = _match(patch, before)
    deletes = [_triple(pattern.substitute(bindings)) for pattern in patch.deletes]
    return deletes, [_triple(pattern.substitute(bindings)) for pattern in patch.inserts]


def missing_deletion(triple: Triple) -> Problem:
    """Return the Problem for a deleted triple that does not exist."""
    return Problem(409, f"The triple to delete does not exist: {triple} . Read the resource again.")


def _triple(pattern: Pattern) -> Triple:
    subject, predicate, object_ = pattern
    assert not isinstance(object_, Variable)
    if not isinstance(subject, NamedNode | BlankNode | Triple) or not isinstance(predicate, NamedNode):
        raise Problem(409, f"With the bindings of solid:where, {pattern} is not a valid triple.")
    return Triple(subject, predicate, object_)


def _match(patch: N3Patch, triples: Sequence[Triple]) -> Bindings:
    """Return the only match of solid:where; unnamed variables may match in several ways."""
    if not patch.where:
        return {}
    found: Bindings | None = None
    for bindings in _Search(triples).solutions(patch.where, {}):
        named = {variable: term for variable, term in bindings.items() if variable not in patch.unnamed}
        if found is not None and named != found:
            raise Problem(409, "solid:where matches in more than one way: make it more specific.")
        found = named
    if found is None:
        raise Problem(409, "solid:where matches nothing in this resource: read it again.")
    return found


class _Search:
    """Matches patterns with triples by indexes, created on first use, within `MAX_STEPS`."""

    def __init__(self, triples: Sequence[Triple]) -> None:
        self._triples = triples
        self._indexes: dict[tuple[int, ...], dict[tuple[object, ...], list[Triple]]] = {}
        self._steps = 0

    def solutions(self, patterns: Sequence[Pattern], bindings: Bindings) -> Iterator[Bindings]:
        """Yield the bindings of variables for which all patterns exist; one may be repeated."""
        rest = [pattern.substitute(bindings) for pattern in patterns]
        fewest: Sequence[Triple] = ()
        chosen: Pattern | None = None
        open_: list[Pattern] = []
        for pattern in rest:
            candidates = self._candidates(pattern)
            if not candidates:
                return
            if not pattern.variables:
                continue
            open_.append(pattern)
            if chosen is None or len(candidates) < len(fewest):
                chosen, fewest = pattern, candidates
        if chosen is None:
            yield bindings
            return
        open_.remove(chosen)
        for triple in fewest:
            self._step()
            more = _bindings(chosen, triple)
            if more is not None:
                yield from self.solutions(open_, {**bindings, **more})

    def _candidates(self, pattern: Pattern) -> Sequence[Triple]:
        """Return the triples that have the terms of a pattern."""
        self._step()
        places = tuple(place for place, each in enumerate(pattern) if not isinstance(each, Variable))
        index = self._indexes.get(places)
        if index is None:
            index = self._indexes[places] = {}
            for triple in self._triples:
                terms = tuple(triple)
                index.setdefault(tuple(terms[place] for place in places), []).append(triple)
        return index.get(tuple(pattern[place] for place in places), ())

    def _step(self) -> None:
        self._steps += 1
        if self._steps > MAX_STEPS:
            raise Problem(422, "Evaluating solid:where takes too long: make it more specific.")


def _bindings(pattern: Pattern, triple: Triple) -> Bindings | None:
    """Return the bindings of a pattern's variables in a triple, or None if they conflict."""
    found: dict[Variable, Term] = {}
    for each, term in zip(pattern, tuple(triple), strict=True):
        if isinstance(each, Variable) and found.setdefault(each, term) != term:
            return None
    return found
