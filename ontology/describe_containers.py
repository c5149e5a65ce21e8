"""Containers described (LDP 5.2): what they contain, and the namespaces within them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from pyoxigraph import Literal, NamedNode, Triple

from rosld.adapters.model import names
from rosld.ontology.describe_graph import SECTIONS
from rosld.ontology.document import Document
from rosld.ontology.namespaces import Members
from rosld.ontology.triples import CONTAINER, statements, text, triples_about
from rosld.ontology.urls import Space
from rosld.ontology.vocab import dcterms, ldp, rdfs, ros


def container_document(url: str, members: Iterable[str], title: str) -> Document:
    """A container and the URLs of its members, those ending in a slash being containers themselves."""
    found = [NamedNode(member) for member in members]
    return Document(
        url,
        tuple(
            triples_about(NamedNode(url), *CONTAINER, (dcterms.title, text(title)), *statements(ldp.contains, found))
        ),
    )


def namespace_document(
    route: str,
    namespace: tuple[str, ...],
    members: Members,
    space: Space,
    *,
    is_name: bool = False,
    whole: str | None = None,
) -> Document:
    """A namespace of names of one kind: its direct members, and the namespaces below, both where a name is both.

    `is_name`: the namespace is a name too (`/camera/image_raw`), and links to it; to `whole` too, the URL at which its
    hidden members are told as well, if there are any. What members are is not told here: in the dataset they say it
    themselves and nobody else, so that a query over all graphs finds it once.
    """
    url = space.container(route, namespace)
    title = SECTIONS.get(route, route.capitalize())
    leaves = {leaf: NamedNode(space.url(route, (*namespace, leaf))) for leaf in members.leaves}
    below = {inner: NamedNode(space.container(route, (*namespace, inner))) for inner in members.namespaces}
    triples = triples_about(
        NamedNode(url),
        *CONTAINER,
        (dcterms.title, text(f"{title} in {names.join(namespace)}" if namespace else title)),
        (ros.name, text(names.join(namespace)) if namespace else None),
        *statements(ldp.contains, leaves.values()),
        *statements(ldp.contains, below.values()),
        (rdfs.seeAlso, NamedNode(space.url(route, namespace)) if is_name else None),
        (rdfs.seeAlso, NamedNode(whole) if whole else None),
    )
    return Document(url, tuple(triples))


def type_container_document(route: str, namespace: tuple[str, ...], below: Sequence[str], space: Space) -> Document:
    """A container of types or shapes: `below` are the type names (`pkg/msg/X`) that lie in this namespace."""
    depth = len(namespace)
    members: dict[str, None] = {}
    for name in below:
        path = tuple(name.split("/"))
        leaf = len(path) == depth + 1
        members[space.url(route, path) if leaf else space.container(route, path[: depth + 1])] = None
    title = SECTIONS[route] + (f" of {'/'.join(namespace)}" if namespace else "")
    document = container_document(space.container(route, namespace), members, title)
    labels = [_label(space.url(route, tuple(name.split("/"))), name) for name in below if name.count("/") == depth]
    return Document(document.url, (*document.triples, *labels))


def _label(url: str, name: str) -> Triple:
    return Triple(NamedNode(url), rdfs.label, Literal(name))
