"""Interaction models (LDP 4, 5): the requested model, its Link headers, membership of containers, and names from Slug.

Pure functions of links, triples and names; invalid requests raise Problems.
"""

from __future__ import annotations

import re
import secrets
import unicodedata
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from urllib.parse import unquote_to_bytes

from pyoxigraph import NamedNode, Triple

from rosld.ontology.body import RdfBody
from rosld.ontology.syntax import Syntax
from rosld.ontology.vocab import ldp, rdf
from rosld.server.http.fields import Link
from rosld.server.http.problem import Problem
from rosld.server.http.token_redaction import redact_tokens
from rosld.server.storage.record import MODEL_TYPES, NO_MEMBER, Membership, Model

_RDF = frozenset(syntax.media_type for syntax in Syntax)
_LINKS: Mapping[Model, tuple[Link, ...]] = {
    model: tuple(Link(kind.value, "type") for kind in kinds if kind != ldp.Container)
    for model, kinds in MODEL_TYPES.items()
}
_KNOWN = frozenset(kind.value.removeprefix(ldp.iri) for kinds in MODEL_TYPES.values() for kind in kinds)
_SERVERS_OWN = frozenset({ldp.contains, rdf.type})
"""Server-managed properties, which membership triples must not use."""


# Models


def requested_model(links: Sequence[Link], url: str, media_type: str | None, *, container_hint: bool) -> Model:
    """Return the interaction model that a request selects by its Link headers, its body and its URL (LDP 5.2.3.4).

    `url` is the URL of the request, `media_type` that of its body, None without one. `container_hint`: the URL of the
    new resource ends in a slash. In a PUT, which determines the URL, both must agree. Raises Problem 400 for an unknown
    model and for models that exclude each other, 409 for a model that does not match the URL or the body.
    """
    requested = _requested_types(links, url)
    container = _container(requested)
    _check_exclusive(requested, container)
    is_rdf = media_type is None or media_type in _RDF
    if container is not None or (container_hint and not requested):
        _check_container(container or Model.BASIC_CONTAINER, url, media_type, is_rdf)
        return container or Model.BASIC_CONTAINER
    if container_hint:
        raise Problem(
            409,
            f"The URL is that of a container, but the request asks for {_words(requested)}: omit the trailing "
            "slash, or ask for ldp:BasicContainer.",
        )
    if "NonRDFSource" in requested:
        return Model.NON_RDF_SOURCE
    if "RDFSource" in requested and not is_rdf:
        raise Problem(
            409,
            f"ldp:RDFSource cannot have a body of type {media_type}: send one of {', '.join(sorted(_RDF))}, or "
            "ask for ldp:NonRDFSource.",
        )
    return Model.RDF_SOURCE if is_rdf else Model.NON_RDF_SOURCE


def model_links(model: Model) -> tuple[Link, ...]:
    """Return the `type` links of every response about a resource of this model.

    LDP 4.2.1.4 requires ldp:Resource, 5.2.1.4 the one type of container, 4.4.1.2 allows ldp:NonRDFSource. 5.2.1.4 does
    not list ldp:Container, which is only stated in the RDF.
    """
    return _LINKS[model]


def _requested_types(links: Sequence[Link], url: str) -> frozenset[str]:
    """Return the local names of the models in the links; other types and links are ignored."""
    found = [
        link.target.removeprefix(ldp.iri)
        for link in links
        if "type" in link.rel.lower().split() and link.anchor in (None, "", url) and link.target.startswith(ldp.iri)
    ]
    for name in found:
        if name not in _KNOWN:
            raise Problem(
                400,
                f"<{ldp.iri}{name}> is not an interaction model; choose from {', '.join(_prefixed(sorted(_KNOWN)))}.",
            )
    return frozenset(found)


def _container(requested: frozenset[str]) -> Model | None:
    """Return the requested kind of container; ldp:Container alone means a Basic one."""
    kinds = [model for model in Model if model.is_container and model.value in requested]
    if len(kinds) > 1:
        raise Problem(400, f"A container has one type, not {_words(requested & {kind.value for kind in kinds})}.")
    if kinds:
        return kinds[0]
    return Model.BASIC_CONTAINER if "Container" in requested else None


def _check_exclusive(requested: frozenset[str], container: Model | None) -> None:
    if "NonRDFSource" in requested and ("RDFSource" in requested or container is not None):
        raise Problem(400, f"{_words(requested - {'Resource'})} are mutually exclusive: ask for one interaction model.")


def _check_container(model: Model, url: str, media_type: str | None, is_rdf: bool) -> None:
    if not url.endswith("/"):
        raise Problem(409, f"The URL of an ldp:{model.value} ends in a slash: send the request to {url}/")
    if not is_rdf:
        raise Problem(
            409,
            f"A container needs an RDF body, not {media_type}: send one of {', '.join(sorted(_RDF))}, or create a "
            "resource that is not a container.",
        )


def _words(names: Iterable[str]) -> str:
    return " and ".join(_prefixed(sorted(names)))


def _prefixed(names: Iterable[str]) -> Iterator[str]:
    return (f"ldp:{name}" for name in names)


# Membership


def parse_membership(triples: Iterable[Triple], url: str, model: Model) -> Membership | None:
    """Return the membership that the body of the container at `url` declares, None for a Basic container.

    Defaults are the container itself as the membership resource and the relation ldp:member (LDP 5.4.1.2, 5.4.1.3); an
    Indirect container must declare ldp:insertedContentRelation (LDP 5.5.1.2). Raises 409 Problems for repeated
    declarations, both directions (LDP 5.4.1.4), or non-IRIs.
    """
    if model not in (Model.DIRECT_CONTAINER, Model.INDIRECT_CONTAINER):
        return None
    container = NamedNode(url)
    declared = [triple for triple in triples if triple.subject == container]
    resource = _one(declared, ldp.membershipResource)
    forward, inverse = _one(declared, ldp.hasMemberRelation), _one(declared, ldp.isMemberOfRelation)
    if forward is not None and inverse is not None:
        raise Problem(
            409, "A container has either ldp:hasMemberRelation or ldp:isMemberOfRelation, not both (LDP 5.4.1.4)."
        )
    relation = forward or inverse or ldp.member
    if relation in _SERVERS_OWN:
        raise Problem(409, f"{relation} is managed by the server: choose another property as the membership relation.")
    content = _content(_one(declared, ldp.insertedContentRelation), model)
    return Membership(
        (resource or container).value, relation.value, inverse is not None, None if content is None else content.value
    )


def member_derived_uri(membership: Membership | None, body: RdfBody, url: str) -> str:
    """Return the member-derived URI of a new member at `url` for membership triples (LDP 5.4.1.5, 5.5.1.2).

    It is the member itself or, with an inserted content relation, its object in the body, `NO_MEMBER` if there is none.
    Statements about the member take precedence. Raises 409 Problems for several objects, or a non-IRI.
    """
    if membership is None or membership.content in (None, ldp.MemberSubject.value):
        return url
    relation = NamedNode(membership.content)
    objects = body.objects(NamedNode(url), relation) or list(
        dict.fromkeys(each for properties in body.subjects.values() for each in properties.get(relation, ()))
    )
    if not objects:
        return NO_MEMBER
    if len(objects) > 1:
        raise Problem(
            409,
            f"A resource in this container must name its member by exactly one triple with {relation} (LDP "
            f"5.5.1.2); the body has {len(objects)}.",
        )
    if not isinstance(objects[0], NamedNode):
        raise Problem(409, f"The member that {relation} names must be an IRI, not {objects[0]}.")
    return objects[0].value


def member_derived_uris(members: Iterable[tuple[str, str | None]]) -> Iterator[str]:
    """Yield the URIs of members in membership triples, from their URLs and records."""
    return (url if stated is None else stated for url, stated in members if stated != NO_MEMBER)


def membership_declaration(membership: Membership, container_url: str) -> list[Triple]:
    """Return the declaration by a Direct or Indirect container of its membership triples.

    It includes the defaults, whether the client stated them or not (LDP 5.4.1.3, 5.4.1.4, 5.5.1.2).
    """
    container = NamedNode(container_url)
    relation = ldp.isMemberOfRelation if membership.inverse else ldp.hasMemberRelation
    triples = [
        Triple(container, ldp.membershipResource, NamedNode(membership.resource)),
        Triple(container, relation, NamedNode(membership.relation)),
    ]
    if membership.content is not None:
        triples.append(Triple(container, ldp.insertedContentRelation, NamedNode(membership.content)))
    return triples


def membership_triples(membership: Membership, members: Iterable[str]) -> list[Triple]:
    """Return the membership triples of these member-derived URIs (LDP 5.4.1.4.1, 5.4.1.4.2)."""
    constant, relation = NamedNode(membership.resource), NamedNode(membership.relation)
    if membership.inverse:
        return [Triple(NamedNode(member), relation, constant) for member in members]
    return [Triple(constant, relation, NamedNode(member)) for member in members]


def _one(declared: Sequence[Triple], predicate: NamedNode) -> NamedNode | None:
    """Return the single IRI that a container states with a predicate, or None."""
    found = list(dict.fromkeys(triple.object for triple in declared if triple.predicate == predicate))
    if len(found) > 1:
        values = " and ".join(map(str, found[:5]))
        raise Problem(409, f"A container has one value of {predicate}, not {values}.")
    if found and not isinstance(found[0], NamedNode):
        raise Problem(409, f"The value of {predicate} must be an IRI, not {found[0]}.")
    return found[0] if found and isinstance(found[0], NamedNode) else None


def _content(relation: NamedNode | None, model: Model) -> NamedNode | None:
    """Return the inserted content relation of an Indirect container; a Direct one has none (LDP 5.4.1.5, 5.5.1.2)."""
    if model is Model.INDIRECT_CONTAINER:
        if relation is None:
            raise Problem(
                409,
                "An Indirect Container needs ldp:insertedContentRelation (LDP 5.5.1.2): add it, or ask for "
                "ldp:DirectContainer.",
            )
        return relation
    if relation not in (None, ldp.MemberSubject):
        raise Problem(
            409,
            f"The members of a Direct Container are its contained resources (LDP 5.4.1.5): omit {relation}, or "
            "ask for ldp:IndirectContainer.",
        )
    return relation


MAX_LENGTH = 100
"""Maximum number of characters of a name."""
_COUNTED = range(2, 10)
"""Numbers tried before random suffixes: searching all names of a large container would take too long."""
_SOUNDS = tuple(consonant + vowel for consonant in "bdfghjklmnprstvz" for vowel in "aeiou")
_RESERVED = re.compile(r"\.meta$", re.IGNORECASE)
_READ = MAX_LENGTH * 12
"""Number of characters of a Slug that are read: each of a name's may be four bytes, each percent-encoded."""
_INVISIBLE = frozenset("\u034f\u115f\u1160\u17b4\u17b5\u3164\uffa0") | {
    chr(code) for span in (range(0x180B, 0x1810), range(0xFE00, 0xFE10), range(0xE0100, 0xE01F0)) for code in span
}
"""Invisible letters and marks (Unicode's Default_Ignorable_Code_Point), which would make two names look the same."""


def choose_name(slug: str | None, taken: Callable[[str], bool]) -> str:
    """Return a name for a new member, not yet percent-encoded: readable, a single path segment, and never used before.

    Letters, marks, digits, `-`, `_` and `.` of the Slug are retained, everything else becomes `-`; without a usable
    Slug the name is made of random syllables. It is in NFC, has at most 100 characters, begins with a letter, a digit
    or `_`, and does not end in a dot or in `.meta`. `taken` returns whether a name exists or ever did (LDP 5.2.3.11);
    then a number or, at last, a random suffix is added.
    """
    stem, extension = _split(_readable(redact_tokens(slug or "")))
    return next(name for name in _candidates(stem or _word(), extension) if not taken(name))


def _candidates(stem: str, extension: str) -> Iterator[str]:
    yield _join(stem, "", extension)
    for number in _COUNTED:
        yield _join(stem, f"-{number}", extension)
    while True:
        yield _join(stem, f"-{secrets.token_hex(4)}", extension)


def _join(stem: str, added: str, extension: str) -> str:
    """Join the parts of a name, truncating the stem if needed (and dropping separators at its new end)."""
    shortened = stem[: MAX_LENGTH - len(added) - len(extension)].rstrip("-.")
    return unicodedata.normalize("NFC", shortened + added + extension)


def _readable(slug: str) -> str:
    """Return the usable characters of a Slug, which may be none."""
    text = unicodedata.normalize("NFC", _decode(slug))
    replaced = "".join(char if _is_safe(char) else "-" for char in text if char not in _INVISIBLE)
    name = re.sub(r"-{2,}", "-", replaced)
    name = re.sub(r"\.{2,}", ".", name)
    while name and (name[0] in "-." or unicodedata.category(name[0])[0] == "M"):
        name = name[1:]
    name = unicodedata.normalize("NFC", name)[:MAX_LENGTH].rstrip("-.")
    return _RESERVED.sub("-meta", name)


def _decode(slug: str) -> str:
    """Return the text of a Slug (RFC 5023 9.7.1): its octets percent-decoded, then decoded as UTF-8."""
    raw = slug[:_READ].encode("latin-1", "ignore") if _is_latin(slug) else slug[:_READ].encode("utf-8", "ignore")
    return unquote_to_bytes(raw).decode("utf-8", "replace")


def _is_latin(text: str) -> bool:
    """Whether a text consists of the octets of a header field."""
    return all(char <= "\xff" for char in text)


def _is_safe(char: str) -> bool:
    return char in "-_." or unicodedata.category(char)[0] in "LMN"


def _split(name: str) -> tuple[str, str]:
    """Return a name without its extension, and the extension."""
    stem, dot, last = name.rpartition(".")
    if dot and stem and re.fullmatch(r"[0-9A-Za-z]{1,15}", last):
        return stem, dot + last
    return name, ""


def _word() -> str:
    """Return a random pronounceable name: two words of three syllables, of 5 * 10^11 possible names."""
    number, sounds = secrets.randbelow(len(_SOUNDS) ** 6), []
    for _ in range(6):
        number, sound = divmod(number, len(_SOUNDS))
        sounds.append(_SOUNDS[sound])
    return "".join(sounds[:3]) + "-" + "".join(sounds[3:])
