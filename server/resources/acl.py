"""`/acl`: the rules in force as Web Access Control says them, for those who administer. Tokens are not in it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

from pyoxigraph import Literal, NamedNode, Triple

from rosld.ontology.document import Document
from rosld.ontology.triples import boolean, statements, text, triples_about
from rosld.ontology.vocab import acl, foaf, rdf, ros
from rosld.server.auth.agent import ANONYMOUS, Agent
from rosld.server.auth.authenticator import Authenticator
from rosld.server.auth.config import MODES
from rosld.server.auth.rules import ACL, AUTHENTICATED, Policy, Rule
from rosld.server.rest.resource import RDF_SOURCE, RESOURCE, Resource
from rosld.server.rest.state import State

_CLASSES = {ANONYMOUS.name: foaf.Agent, AUTHENTICATED: acl.AuthenticatedAgent}
_MODES = {mode: term for term, mode in MODES.items()}


class AclResource(Resource):
    """The rules: written in their file, read here."""

    kind = "Rights"
    title = "Rights"
    links = (RESOURCE, RDF_SOURCE)

    def __init__(self, base: str, authenticator: Authenticator) -> None:
        super().__init__(f"{base}{ACL}")
        self._authenticator = authenticator

    def deny_reason(self, method: str) -> str:
        return "The rules are written in the file of --auth; it is read again whenever it changes."

    @property
    def conforms_to(self) -> Sequence[str]:
        return (f"{self.url.removesuffix(ACL)}shapes/documents#Authorization",)

    async def state(self) -> State:
        policy = self._authenticator.config.policy
        return State(lambda: Document(self.url, tuple(policy_document(policy, self.url))))


def policy_document(policy: Policy, url: str) -> Iterable[Triple]:
    """Yield the triples of agents and rules, without credentials."""
    nodes = {agent.name: _node(agent, number, url) for number, agent in enumerate(policy.agents.values(), 1)}
    by_webid = {agent.webid: nodes[agent.name] for agent in policy.agents.values() if agent.webid}
    for agent in policy.agents.values():
        yield from triples_about(nodes[agent.name], (rdf.type, foaf.Agent), (ros.name, text(agent.name)))
    for number, rule in enumerate(policy.rules, 1):
        yield from _authorization(rule, NamedNode(f"{url}#rule-{number}"), {**by_webid, **nodes})


def _node(agent: Agent, number: int, url: str) -> NamedNode:
    return NamedNode(agent.webid or f"{url}#agent-{number}")


def _authorization(rule: Rule, node: NamedNode, nodes: Mapping[str, NamedNode]) -> Iterable[Triple]:
    names = sorted(rule.agents)
    return triples_about(
        node,
        (rdf.type, acl.Authorization),
        *statements(acl.agentClass, (_CLASSES[name] for name in names if name in _CLASSES)),
        *statements(acl.agent, (nodes[name] for name in names if name in nodes)),
        *statements(acl.mode, (_MODES[mode] for mode in sorted(rule.modes, key=lambda mode: mode.value))),
        *statements(ros.glob, (Literal(glob.text) for glob in rule.globs)),
        *statements(ros.typeGlob, map(Literal, rule.types)),
        (ros.deny, boolean(True) if rule.deny else None),
    )
