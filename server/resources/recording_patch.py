"""Patches of a recording that is being made: it can be ended, and nothing else, in JSON or in RDF."""

from __future__ import annotations

from collections.abc import Iterable

import orjson
from pyoxigraph import Literal, NamedNode, Triple

from rosld.ontology.vocab import ros
from rosld.server.http.problem import Problem
from rosld.server.patches.n3patch import apply_patch, read_patch
from rosld.server.patches.patch import apply_update
from rosld.server.rest.formats import MERGE_PATCH, SPARQL_UPDATE

N3_PATCH = "text/n3"
PATCHES = (MERGE_PATCH, SPARQL_UPDATE, N3_PATCH)
_ENDED = "ended"
_WORDS = 'A recording can be ended, and nothing else: send {"status": "ended"}, or have ros:recordingStatus be "ended".'


def require_end(data: bytes, media_type: str, url: str, before: Iterable[Triple]) -> None:
    """Raise Problems where a patch of the recording at `url`, which says `before`, does anything but end it.

    400 for what cannot be read, 409 for an N3 patch that does not fit, 422 for anything else.
    """
    if media_type not in (SPARQL_UPDATE, N3_PATCH):
        try:
            said: object = orjson.loads(data)
        except orjson.JSONDecodeError as error:
            raise Problem(400, f"This is no JSON: {error}.") from error
        if said != {"status": _ENDED}:
            raise Problem(422, _WORDS)
        return
    known = list(before)
    if media_type == N3_PATCH:
        after = set(apply_patch(read_patch(data, url), known))
        statuses = {each.object for each in after if each.predicate == ros.recordingStatus}
        others = {each for each in after if each.predicate != ros.recordingStatus}
        is_rest_same = others == {each for each in known if each.predicate != ros.recordingStatus}
    else:
        body = apply_update(data, known, url, by_value=True)
        statuses = set(body.objects(NamedNode(url), ros.recordingStatus))
        is_rest_same = True
    if statuses != {Literal(_ENDED)} or not is_rest_same:
        raise Problem(422, _WORDS)
