"""PATCH of a resource that permits a single change, such as ending it. No I/O."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import orjson
from msgspec import Struct
from pyoxigraph import Literal, NamedNode, Triple

from rosld.server.http.problem import Problem
from rosld.server.patches.n3patch import apply_patch, read_patch
from rosld.server.patches.patch import apply_update
from rosld.server.rest.formats import MERGE_PATCH, SPARQL_UPDATE

_N3_PATCH = "text/n3"
PATCHES = (MERGE_PATCH, SPARQL_UPDATE, _N3_PATCH)


class SingleChange(Struct, frozen=True):
    """The only permitted change: the JSON that requests it, and the predicate with its new value in RDF.

    `words` is the sentence that refuses any other change.
    """

    json: Mapping[str, str]
    predicate: NamedNode
    value: NamedNode | Literal
    words: str

    def require(self, data: bytes, media_type: str, url: str, before: Iterable[Triple]) -> None:
        """Raise a Problem unless a patch of the resource at `url`, with the triples `before`, is this change.

        400 for an unreadable patch, 409 for an N3 patch that does not match, 422 for any other change.
        """
        if media_type not in (SPARQL_UPDATE, _N3_PATCH):
            try:
                change: object = orjson.loads(data)
            except orjson.JSONDecodeError as error:
                raise Problem(400, f"The body is not JSON: {error}.") from error
            if change != self.json:
                raise Problem(422, self.words)
            return
        known, after = patched(data, media_type, url, before)
        own = {each for each in after if each.predicate == self.predicate}
        rest = {each for each in known if each.predicate != self.predicate}
        if own != {Triple(NamedNode(url), self.predicate, self.value)} or after - own != rest:
            raise Problem(422, self.words)


def patched(data: bytes, media_type: str, url: str, before: Iterable[Triple]) -> tuple[set[Triple], set[Triple]]:
    """Return the triples of a resource before and after a patch of its RDF, in the same spelling of values.

    Raises Problems: 400 for an unreadable patch, 409 for an N3 patch that does not match.
    """
    known = set(before)
    if media_type == _N3_PATCH:
        return known, set(apply_patch(read_patch(data, url), list(known)))
    return _updated(b"DELETE DATA {}", known, url), _updated(data, known, url)


def _updated(update: bytes, before: Iterable[Triple], url: str) -> set[Triple]:
    """Return triples after a SPARQL Update, in the store's spelling of values."""
    subjects = apply_update(update, before, url, by_value=True).subjects
    return {
        Triple(subject, predicate, value)
        for subject, properties in subjects.items()
        for predicate, values in properties.items()
        for value in values
    }
