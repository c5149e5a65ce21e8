"""The modules of the ontology: each is one owl:Ontology, in the file of its name next to this one or in `align/`.

The terms of `ros:` are in several modules, but their IRIs resolve to the core. Therefore the core, as served, states
for each of them which module defines it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import cache
from importlib.resources import files

from pyoxigraph import NamedNode, RdfFormat, Triple, parse

from rosld.ontology.vocab import av, mapping, owl, rdf, rdfs, ros

ROOT = "https://w3id.org/rosld"
VERSION = "0.2.0"
CORE = "core"
OWN = (CORE, "types", "interaction", "recording", "body", "server", "mapping", "aircraft")
"""Modules that define terms."""
DATA = ("units", "sensors")
"""Modules that state facts about types."""
_ALIGNED = ("sosa", "prov", "wot", "ldp", "qudt", "geosparql", "dcat", "cora", "soma", "ease")
ALIGNMENTS = tuple(f"align-{name}" for name in _ALIGNED)
"""Modules that relate these terms to other vocabularies."""
MODULES = (*OWN, *DATA, *ALIGNMENTS)
_NAMESPACES = (ros.iri, mapping.iri, av.iri)
_DECLARED = (ros.iri, owl.iri, rdf.iri, rdfs.iri)
"""Namespaces of classes that the core, as served, may state as types of terms."""


def module_iri(name: str, version: str = "") -> str:
    """Return the IRI of a module; with a version, that of this version of it."""
    return "/".join(part for part in (ROOT, version, "" if name == CORE else name) if part)


def module_url(name: str, base: str) -> str:
    """Return the URL of a module on a server at `base`."""
    return f"{base}ontology" if name == CORE else f"{base}ontology/{name}"


def module_path(name: str) -> str:
    """Return the path of the file of a module."""
    return f"{name.replace('-', '/')}.ttl"


@cache
def module_triples(name: str) -> tuple[Triple, ...]:
    """Return the triples of a module as in its file."""
    text = files("rosld.ontology").joinpath(module_path(name)).read_bytes()
    return tuple(quad.triple for quad in parse(text, format=RdfFormat.TURTLE))


@cache
def served_triples(name: str) -> tuple[Triple, ...]:
    """Return the triples of a module as served: the core includes the module of each other term of `ros:`."""
    own = module_triples(name)
    if name != CORE:
        return own
    return tuple(dict.fromkeys((*own, *(each for other in OWN if other != CORE for each in _signposts(other)))))


def _signposts(name: str) -> Iterator[Triple]:
    """Yield the kind, label and module of each term of `ros:` in a module.

    Classes of other vocabularies are left out: the core does not declare them (OWL 2 DL).
    """
    terms = {iri for iri, home in home_of_terms().items() if home == name and iri.startswith(ros.iri)}
    for triple in module_triples(name):
        subject, predicate, value = triple
        if not isinstance(subject, NamedNode) or subject.value not in terms:
            continue
        if predicate in (rdfs.label, rdfs.isDefinedBy) or (
            predicate == rdf.type and isinstance(value, NamedNode) and value.value.startswith(_DECLARED)
        ):
            yield triple


@cache
def home_of_terms() -> Mapping[str, str]:
    """Return the module that defines each term, by the term's IRI."""
    return {
        triple.subject.value: name
        for name in OWN
        for triple in module_triples(name)
        if triple.predicate == rdfs.isDefinedBy and isinstance(triple.subject, NamedNode)
    }


def term_url(iri: str, base: str) -> str | None:
    """Return the URL that describes a term or a module on a server at `base`; None for other IRIs."""
    if iri in _modules():
        return base + _modules()[iri]
    if iri.startswith(_NAMESPACES):
        fragment = iri.partition("#")[2]
        return f"{module_url(home_of_terms().get(iri, CORE), base)}#{fragment}"
    return None


@cache
def _modules() -> Mapping[str, str]:
    """Return the path of each module, by its IRI and by the IRI of its version."""
    return {module_iri(name, version): module_url(name, "") for name in MODULES for version in ("", VERSION)}
