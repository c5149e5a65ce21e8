"""Cockpits that clients store: their validation and listing."""

from __future__ import annotations

from itertools import islice

from pyoxigraph import NamedNode, RdfFormat, Triple, parse

from rosld.ontology.cockpit import read_cockpit
from rosld.ontology.urls import Space, decode_segment
from rosld.ontology.violations import LoweringError, Violation, brief_value
from rosld.ontology.vocab import rdf, ros
from rosld.server.storage.record_documents import unpack_triples
from rosld.server.storage.sqlite import Records
from rosld.shapes.validation import MAX_PANELS, ValidationResult, validate

ROUTE = "cockpit/"
DEFAULT = "default"
"""Name of the cockpit generated for the robot."""
_MAX_TRIPLES = 1500
_MAX_VIOLATIONS = 20


class InvalidCockpit(LoweringError):
    """The document is not a valid cockpit."""


def cockpit_titles(records: Records, space: Space, limit: int) -> list[tuple[str, str]]:
    """Return the URLs of the first stored cockpits, each with its title, or else its name."""
    found = []
    for member in records.members(ROUTE, limit=limit):
        record, url = records.get(member.path), space.base + member.path
        if record is not None and not record.model.is_container:
            triples = (quad.triple for quad in parse(unpack_triples(record.triples), RdfFormat.N_TRIPLES))
            found.append((url, read_cockpit(triples, url).title or name_of(member.path)))
    return found


def check_cockpit(data: bytes, url: str) -> None:
    """Validate the N-Triples of a cockpit to be stored at a URL. Raises InvalidCockpit with the errors."""
    # A document that is far too long is not parsed completely just to count its triples.
    triples = [quad.triple for quad in islice(parse(data, RdfFormat.N_TRIPLES), _MAX_TRIPLES + 1)]
    if len(triples) > _MAX_TRIPLES:
        words = f"a cockpit can have at most {MAX_PANELS} panels and {_MAX_TRIPLES} triples; split it"
        raise InvalidCockpit(Violation("", words))
    if strange := next((each for each in triples if Triple in (type(each.subject), type(each.object))), None):
        raise InvalidCockpit(Violation("", "a cockpit cannot contain triple terms", brief_value(str(strange))))
    found = [_violation(each, url) for each in validate(triples, "cockpit")]
    if Triple(NamedNode(url), rdf.type, ros.Cockpit) not in triples:
        words = f"the document does not describe a cockpit: <{url}> (<> in it) must be a ros:Cockpit"
        found.insert(0, Violation("", words))
    if found:
        once = {(each.path, each.message): each for each in found}  # one message covers several constraints
        raise InvalidCockpit(*(once[key] for key in sorted(once)[:_MAX_VIOLATIONS]))


def _violation(result: ValidationResult, url: str) -> Violation:
    node = NamedNode(url) if isinstance(result.focus, str) else result.focus
    focus = result.focus if isinstance(result.focus, str) else result.focus.value
    name = focus.removeprefix(url) or "<>"
    predicate = "" if result.predicate is None else _short(result.predicate.value)
    return Violation(
        f"{name} {predicate}".strip(),
        result.message,
        brief_value(result.value),
        result.component,
        None,
        node,
        result.predicate,
    )


def _short(iri: str) -> str:
    """Return the short form of a term for error messages."""
    return f"ros:{iri.removeprefix(ros.iri)}" if iri.startswith(ros.iri) else iri.rpartition("#")[2].rpartition("/")[2]


def name_of(path: str) -> str:
    """Return the name of the cockpit with this path."""
    return decode_segment(path.removeprefix(ROUTE))
