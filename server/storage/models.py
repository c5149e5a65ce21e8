"""What each interaction model is in RDF (LDP 4.3.1.2, 5.2.1.2)."""

from __future__ import annotations

from collections.abc import Mapping

from pyoxigraph import NamedNode

from rosld.ontology.vocab import ldp
from rosld.server.storage.record import Model

_PLAIN = (ldp.Resource, ldp.RDFSource)
MODEL_TYPES: Mapping[Model, tuple[NamedNode, ...]] = {
    Model.RDF_SOURCE: _PLAIN,
    Model.NON_RDF_SOURCE: (ldp.Resource, ldp.NonRDFSource),
    Model.BASIC_CONTAINER: (*_PLAIN, ldp.Container, ldp.BasicContainer),
    Model.DIRECT_CONTAINER: (*_PLAIN, ldp.Container, ldp.DirectContainer),
    Model.INDIRECT_CONTAINER: (*_PLAIN, ldp.Container, ldp.IndirectContainer),
}


def rdf_types(model: Model) -> tuple[NamedNode, ...]:
    """The classes that a resource of this model is said to be of in its RDF (LDP 4.3.1.2, 5.2.1.2)."""
    return MODEL_TYPES[model]
