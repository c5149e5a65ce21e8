"""Configuration file of `--auth`: agents, tokens, trusted issuers and rules, in TOML or Turtle.

TOML has the tables `[[token]]` (agent, sha256), `[[agent]]` (name, webid, issuer, subject), `[[issuer]]` (url,
audience, algorithms, keys) and `[[rule]]` (agents, modes, paths, types, deny). Turtle declares agents and rules with
Web Access Control (acl:Authorization), extended by terms of rosld. Unknown content is rejected.
"""

from __future__ import annotations

import logging
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TypeVar
from urllib.parse import urlsplit

from msgspec import Struct, field
from pyoxigraph import BlankNode, Literal, NamedNode, RdfFormat, parse

from rosld.ontology.vocab import acl, foaf, rdf, ros
from rosld.server.auth.rules import ANONYMOUS, AUTHENTICATED, Agent, Glob, Mode, Policy, Rule
from rosld.server.auth.tokens import DIGEST, TokenTable

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

_log = logging.getLogger("rosld")
_V = TypeVar("_V")
_ALGORITHMS = ("RS256", "RS384", "RS512", "PS256", "PS384", "PS512", "ES256", "ES384", "ES512", "EdDSA")
"""Signature algorithms of issuers' tokens: neither shared secrets nor unsigned tokens."""
_USUAL = ("RS256", "ES256")
MODES: Mapping[NamedNode, Mode] = {
    acl.Read: Mode.READ,
    acl.Write: Mode.WRITE,
    acl.Control: Mode.ADMINISTER,
    ros.Command: Mode.CONTROL,
}
"""Modes by their RDF terms: acl:Control concerns the rules themselves."""
_MAX_BYTES = 4 * 1024 * 1024


class Issuer(Struct, frozen=True):
    """A trusted OpenID Connect issuer of access tokens for `audience`.

    `keys` is the URL of its keys, None to find it in the issuer's configuration.
    """

    url: str
    audience: str
    algorithms: tuple[str, ...] = _USUAL
    keys: str | None = None


class AuthConfig(Struct, frozen=True):
    """Contents of the file of `--auth`. `subjects` are the names of agents by issuer and subject."""

    policy: Policy
    tokens: TokenTable
    issuers: tuple[Issuer, ...] = ()
    subjects: Mapping[tuple[str, str], str] = field(default_factory=dict)


def read_config(path: Path, base: str) -> AuthConfig:
    """Return the configuration in a file; `base` resolves relative IRIs in Turtle. Raises ValueError."""
    try:
        data = path.read_bytes()
    except OSError as error:
        raise ValueError(f"--auth {path}: {error.strerror or error}") from error
    if len(data) > _MAX_BYTES:
        raise ValueError(f"--auth {path}: larger than {_MAX_BYTES} bytes")
    try:
        return from_turtle(data, base) if path.suffix in (".ttl", ".turtle") else from_toml(data)
    except (ValueError, SyntaxError) as error:
        raise ValueError(f"--auth {path}: {error}") from error


# TOML


class _Table:
    """A table of the file; each member is taken once, and `end` rejects the remaining ones."""

    def __init__(self, kind: str, number: int, members: object) -> None:
        self._where = f"{kind} {number}"
        if not isinstance(members, dict):
            raise ValueError(f"{self._where}: write it as a table, [[{kind}]]")
        self._left = dict(members)

    def text(self, name: str) -> str:
        """Return a required text."""
        found = self.maybe(name)
        if found is None:
            raise ValueError(f"{self._where} has no {name}")
        return found

    def maybe(self, name: str) -> str | None:
        """Return an optional text, or None."""
        found = self._left.pop(name, None)
        if found is not None and (not isinstance(found, str) or not found):
            raise ValueError(f"{self._where}: {name} must be a string, not {found!r}")
        return found

    def texts(self, name: str, default: Sequence[str] | None = None) -> tuple[str, ...]:
        """Return a list of texts; a single text needs no brackets."""
        found = self._left.pop(name, default)
        found = [found] if isinstance(found, str) else found
        if not isinstance(found, Sequence) or not all(isinstance(each, str) and each for each in found):
            raise ValueError(
                f"{self._where}: {name} must be a list of strings" + ("" if found is None else f", not {found!r}")
            )
        if not found and default is None:
            raise ValueError(f"{self._where}: {name} is empty")
        return tuple(found)

    def flag(self, name: str) -> bool:
        """Return a boolean, by default False."""
        found = self._left.pop(name, False)
        if not isinstance(found, bool):
            raise ValueError(f"{self._where}: {name} must be true or false, not {found!r}")
        return found

    def drop(self, *names: str) -> None:
        """Discard members that are only for people."""
        for name in names:
            self._left.pop(name, None)

    def end(self) -> None:
        """Raise ValueError if unknown members are left."""
        if self._left:
            raise ValueError(f"{self._where}: unknown key {next(iter(self._left))!r}")

    def checked(self, make: Callable[[], _V]) -> _V:
        """Return the result of `make`, adding the location to its ValueError."""
        try:
            return make()
        except ValueError as error:
            raise ValueError(f"{self._where}: {error}") from error


def from_toml(data: bytes) -> AuthConfig:
    """Return the configuration in TOML. Raises ValueError naming the table and the error."""
    members = tomllib.loads(data.decode("utf-8"))
    kinds = ("agent", "token", "issuer", "rule")
    for kind, tables in members.items():
        if kind not in kinds or not isinstance(tables, list):
            raise ValueError(f"unknown table {kind!r}; choose from {', '.join(f'[[{each}]]' for each in kinds)}")
    agents, subjects = _agents(_tables(members, "agent"))
    tokens: dict[str, str] = {}
    for table in _tables(members, "token"):
        name = table.checked(lambda table=table: _name(table.text("agent")))  # type: ignore[misc]
        tokens[table.checked(lambda table=table: _digest(table.text("sha256")))] = name  # type: ignore[misc]
        table.drop("created", "note")
        table.end()
        agents.setdefault(name, Agent(name))
    issuers = tuple(map(_issuer, _tables(members, "issuer")))
    rules = tuple(map(_rule, _tables(members, "rule")))
    return _auth_config(agents, tokens, issuers, subjects, rules)


def _tables(members: Mapping[str, object], kind: str) -> Iterator[_Table]:
    found = members.get(kind, [])
    assert isinstance(found, list)
    return (_Table(kind, number, table) for number, table in enumerate(found, 1))


def _agents(tables: Iterable[_Table]) -> tuple[dict[str, Agent], dict[tuple[str, str], str]]:
    agents: dict[str, Agent] = {}
    subjects: dict[tuple[str, str], str] = {}
    for table in tables:
        name = table.checked(lambda table=table: _name(table.text("name")))  # type: ignore[misc]
        webid, issuer, subject = table.maybe("webid"), table.maybe("issuer"), table.maybe("subject")
        if name in agents:
            raise ValueError(f"two agents are named {name!r}")
        if (issuer is None) != (subject is None):
            raise ValueError(f"agent {name!r}: issuer and subject must be given together")
        agents[name] = Agent(name, webid)
        if issuer is not None and subject is not None:
            subjects[issuer, subject] = name
        table.end()
    return agents, subjects


def _issuer(table: _Table) -> Issuer:
    found = table.checked(
        lambda: _checked_issuer(
            Issuer(
                table.text("url"),
                table.text("audience"),
                table.texts("algorithms", _USUAL),
                table.maybe("keys"),
            )
        )
    )
    table.end()
    return found


def _rule(table: _Table) -> Rule:
    rule = table.checked(
        lambda: Rule(
            frozenset(table.texts("agents")),
            frozenset(map(_mode, table.texts("modes"))),
            tuple(map(Glob, table.texts("paths"))),
            table.texts("types", ()),
            table.flag("deny"),
        )
    )
    table.drop("note")
    table.end()
    return rule


def _mode(name: str) -> Mode:
    try:
        return Mode(name)
    except ValueError:
        raise ValueError(f"{name!r} is not a mode; choose from {', '.join(mode.value for mode in Mode)}") from None


# Both


def _name(name: str) -> str:
    if name in (ANONYMOUS.name, AUTHENTICATED):
        raise ValueError(f"{name!r} is not a valid agent name: it is reserved for all agents")
    if not name.isprintable() or ":" in name or len(name) > 200:
        raise ValueError(f"{name[:200]!r} is not a valid agent name: use at most 200 letters, without colons")
    return name


def _digest(text: str) -> str:
    found = text if text.startswith("sha256:") else f"sha256:{text}"
    if not DIGEST.fullmatch(found):
        raise ValueError(f"{text[:20]!r}... is not the SHA-256 digest of a token: create one with `rosld token add`")
    return found


def _checked_issuer(issuer: Issuer) -> Issuer:
    for url in filter(None, (issuer.url, issuer.keys)):
        parts = urlsplit(url)
        is_local = parts.hostname in ("localhost", "127.0.0.1", "::1")
        if not (parts.scheme == "https" or (parts.scheme == "http" and is_local)) or parts.username is not None:
            raise ValueError(f"{url!r} is not an https URL, which the keys must come from")
    for one in issuer.algorithms:
        if one not in _ALGORITHMS:
            raise ValueError(f"the algorithm {one!r} is not supported; choose from {', '.join(_ALGORITHMS)}")
    return issuer


def _auth_config(
    agents: Mapping[str, Agent],
    tokens: Mapping[str, str],
    issuers: tuple[Issuer, ...],
    subjects: Mapping[tuple[str, str], str],
    rules: tuple[Rule, ...],
) -> AuthConfig:
    """Return the configuration after checks that its parts are consistent."""
    urls = {issuer.url for issuer in issuers}
    for issuer, subject in subjects:
        if issuer not in urls:
            raise ValueError(f"agent {subjects[issuer, subject]!r}: no [[issuer]] {issuer} is configured")
    known = {ANONYMOUS.name, AUTHENTICATED, *agents, *(one.webid for one in agents.values() if one.webid)}
    for rule in rules:
        for name in rule.agents:
            if name not in known and not issuers:
                _log.warning("--auth: a rule names %r, but no [[agent]] or [[token]] does", name)
    return AuthConfig(Policy(rules, agents), TokenTable(tokens), issuers, subjects)


# Turtle


def from_turtle(data: bytes, base: str) -> AuthConfig:
    """Return the configuration in Turtle; IRIs below `base` are paths. Raises ValueError and SyntaxError."""
    graph = _Graph((quad.subject, quad.predicate, quad.object) for quad in parse(data, RdfFormat.TURTLE, base_iri=base))
    agents: dict[str, Agent] = {}
    tokens: dict[str, str] = {}
    called: dict[str, str] = {}
    for node in graph.of(foaf.Agent):
        name = _name(graph.text(node, ros.name))
        agents[name] = Agent(name, node.value if isinstance(node, NamedNode) else None)
        called[node.value] = name
        for each in graph.all(node, ros.tokenDigest):
            tokens[_digest(_text(each))] = name
    rules = tuple(_authorization(graph, node, base, called) for node in graph.of(acl.Authorization))
    return _auth_config(agents, tokens, (), {}, rules)


_Node = NamedNode | BlankNode


class _Graph:
    """Triples, looked up by subject."""

    def __init__(self, triples: Iterable[tuple[object, NamedNode, object]]) -> None:
        self._by_subject: dict[object, list[tuple[NamedNode, object]]] = {}
        for subject, predicate, object in triples:
            self._by_subject.setdefault(subject, []).append((predicate, object))

    def of(self, kind: NamedNode) -> list[_Node]:
        """Return the subjects of a class."""
        found = (node for node, statements in self._by_subject.items() if (rdf.type, kind) in statements)
        return [node for node in found if isinstance(node, NamedNode | BlankNode)]

    def all(self, node: _Node, predicate: NamedNode) -> list[object]:
        """Return the objects of a subject."""
        return [object for found, object in self._by_subject.get(node, ()) if found == predicate]

    def predicates(self, node: _Node) -> frozenset[NamedNode]:
        """Return all predicates of a subject."""
        return frozenset(predicate for predicate, _ in self._by_subject.get(node, ()))

    def text(self, node: _Node, predicate: NamedNode) -> str:
        """Return the single text of a subject."""
        found = self.all(node, predicate)
        if len(found) != 1:
            raise ValueError(f"{node} must have one {predicate}, not {len(found)}")
        return _text(found[0])


def _text(term: object) -> str:
    if not isinstance(term, Literal) or not term.value:
        raise ValueError(f"{term} must be a string")
    return term.value


def _iri(term: object) -> str:
    if not isinstance(term, NamedNode):
        raise ValueError(f"{term} must be an IRI")
    return term.value


_AUTHORIZATION = frozenset(
    {
        rdf.type, acl.agent, acl.agentClass, acl.accessTo, acl.default, acl.mode,
        ros.glob, ros.typeGlob, ros.deny,
    }
)  # fmt: skip
_CLASSES: Mapping[object, str] = {foaf.Agent: ANONYMOUS.name, acl.AuthenticatedAgent: AUTHENTICATED}


def _authorization(graph: _Graph, node: _Node, base: str, called: Mapping[str, str]) -> Rule:
    """Return a rule as an acl:Authorization (Web Access Control 4)."""
    if unknown := graph.predicates(node) - _AUTHORIZATION:
        raise ValueError(f"the authorization {node} has an unknown property {next(iter(unknown))}")
    agents = {called.get(_iri_or_label(each), _iri_or_label(each)) for each in graph.all(node, acl.agent)}
    for each in graph.all(node, acl.agentClass):
        if each not in _CLASSES:
            raise ValueError(f"the authorization {node}: acl:agentClass must be foaf:Agent or acl:AuthenticatedAgent")
        agents.add(_CLASSES[each])
    modes = set()
    for each in graph.all(node, acl.mode):
        if not isinstance(each, NamedNode) or each not in MODES:
            raise ValueError(
                f"the authorization {node}: {each} is not a mode; choose from {', '.join(map(str, MODES))}"
            )
        modes.add(MODES[each])
    globs = [Glob(_text(each)) for each in graph.all(node, ros.glob)]
    globs += [Glob(_local(_iri(each), base)) for each in graph.all(node, acl.accessTo)]
    globs += [Glob(_local(_iri(each), base).rstrip("/") + "/**") for each in graph.all(node, acl.default)]
    deny = graph.all(node, ros.deny)
    if not agents or not modes or not globs:
        raise ValueError(f"the authorization {node} needs an agent, a mode and a resource")
    types = tuple(map(_text, graph.all(node, ros.typeGlob)))
    return Rule(frozenset(agents), frozenset(modes), tuple(globs), types, [_text(each) for each in deny] == ["true"])


def _iri_or_label(term: object) -> str:
    if not isinstance(term, NamedNode | BlankNode):
        raise ValueError(f"acl:agent {term} must be a described agent")
    return term.value


def _local(iri: str, base: str) -> str:
    """Return the path of an IRI of this server, as a glob that matches only this path."""
    if not iri.startswith(base):
        raise ValueError(f"{iri} does not belong to this server, which is {base}")
    path = iri[len(base) - 1 :].partition("#")[0]
    if "*" in path:
        raise ValueError(f"{iri} contains a *: use ros:glob for patterns")
    return path
