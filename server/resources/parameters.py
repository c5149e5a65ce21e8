"""Parameters, and the form that sets one."""

from __future__ import annotations

import contextlib
import secrets
from collections.abc import Mapping, Sequence

from msgspec.structs import replace
from pyoxigraph import NamedNode, Triple

from rosld.adapters.model import Descriptor, Graph, Kind, Operation, ParameterValue, Ref, names
from rosld.ontology.body import index_triples, parse_body, parse_json
from rosld.ontology.document import Document
from rosld.ontology.parameters import Json, lower_json, lower_parameter, parameter_document, parameter_json, plain_value
from rosld.ontology.triples import text, triples_about
from rosld.ontology.vocab import rdfs, ros
from rosld.server.auth.enforcement import require_subtree
from rosld.server.events.query_params import EVENT_STREAM
from rosld.server.html.forms import DeleteForm, Form, ValueForm
from rosld.server.html.view import escape_controls
from rosld.server.http.conditional import digest
from rosld.server.http.problem import Problem
from rosld.server.http.token_redaction import redact_tokens
from rosld.server.hypermedia.json_schema import OBJECT, JsonSchema, MessageSchemas
from rosld.server.patches.patch import apply_update, merge_patch
from rosld.server.resources.accepted_shape import has_parameter_shape, parameter_shape, shape_query
from rosld.server.resources.namespaces import LISTING_PARAMETERS, count_members
from rosld.server.resources.parameter_base import (
    ParameterBase,
    ParameterContainer,
    changed_values,
    descriptor_of,
    leaf_values,
    require_not_fixed,
)
from rosld.server.rest.exchange import Exchange
from rosld.server.rest.formats import JSON, MERGE_PATCH, OFFERS, RDF_BODIES, SPARQL_UPDATE
from rosld.server.rest.paging import require_page
from rosld.server.rest.path_item import PathItem, WriteMethod
from rosld.server.rest.resource import READ, Answer, CreatedAnswer, Plan, Resource, RobotWrite, permanent_redirect
from rosld.server.rest.state import State
from rosld.server.robot.write_policy import parameter_denied_reason
from rosld.server.runtime.dry_run import DryRunEnded, end_dry_run, expect_status
from rosld.server.runtime.tasks import loop_time
from rosld.shapes.parameter import choice_words, declared_shape, declared_triples, require_form
from rosld.shapes.value import OpenShape


def parameter_form(value: Json, descriptor: Descriptor | None, note: str | None) -> Form:
    """Return the form for a value, constrained by the declaration of the parameter if there is one."""
    title = "Set the parameter"
    if descriptor is None:
        return ValueForm(OpenShape(), title=title, value=value, about=note or "")
    choices = "; ".join(choice_words(descriptor))
    words = (descriptor.description, descriptor.constraints, f"{choices}." if choices else "")
    about = escape_controls(" ".join(filter(None, words)))
    shape = OpenShape() if isinstance(value, dict | list) else declared_shape(descriptor)
    return ValueForm(shape, title=title, value=value, about=about)


_AT_START = "Stored by the parameter server: nodes may read it only when they start."
_MAX_SLUG = 100
_VALUES: tuple[JsonSchema, ...] = (
    {"type": "string"}, {"type": "number"}, {"type": "boolean"}, {"type": "array", "items": {}},
)  # fmt: skip
_NEW_VALUE: JsonSchema = {"anyOf": [*_VALUES, {"type": "object"}]}


class ParameterResource(ParameterBase):
    """One parameter that is not a tree."""

    kind = "Parameter"
    accepts: Mapping[str, Sequence[str]] = {"PUT": (*RDF_BODIES, JSON), "PATCH": (MERGE_PATCH, SPARQL_UPDATE)}

    @property
    def constrained_by(self) -> str | None:
        if has_parameter_shape(self.session.graph, self.name):
            return shape_query(self.url)
        return super().constrained_by

    async def accepted(self, url: str) -> Document | None:
        return await parameter_shape(self.limit_checks, self.name, url)

    def deny_reason(self, method: str) -> str:
        words = parameter_denied_reason(self.session.graph, self.name, delete=method == "DELETE")
        return self.closed_reason or words or super().deny_reason(method)

    def path_item(self, schemas: MessageSchemas) -> PathItem:
        return PathItem(
            f"The parameter {self.name}",
            plain={"anyOf": [*_VALUES]},
            writes={
                "PUT": WriteMethod("Sets the value.", _NEW_VALUE, "At once.", done=(200, 201, 204)),
                "PATCH": WriteMethod(sends=_NEW_VALUE, done=(200, 204)),
                "DELETE": WriteMethod(done=(204,)),
            },
            has_shape=True,
        )

    def _note(self, graph: Graph) -> str | None:
        """Return the explanation of a value stored by the parameter server; None for a parameter of a node."""
        parameter = graph.parameters.get(self.name)
        is_kept = parameter is None or parameter.node is None  # a new parameter is not in the graph yet
        return _AT_START if is_kept and self.session.adapter.capabilities.parameter_server else None

    async def select_variant(self, exchange: Exchange) -> Resource:
        """Return the parameter or its shape. Raises a 404 Problem for past values."""
        if exchange.method in ("GET", "HEAD") and (names := exchange.query.keys() & {"at", "timemap", "series"}):
            raise Problem(404, f"?{min(names)}: parameter values are not recorded: request the current one.")
        return await super().select_variant(exchange)

    def methods(self) -> frozenset[str]:
        methods = READ
        if self.allows(Operation.SET_PARAMETER):
            methods |= {"PUT", "PATCH"}
        if self.allows(Operation.DELETE_PARAMETER):
            methods |= {"DELETE"}
        return methods

    async def state(self) -> State:
        value = await self._value()
        if value is None:
            raise Problem(404, f"There is no parameter {self.name}.")
        if isinstance(value, dict):
            raise permanent_redirect(self._tree_url())
        return self.state_of(value)

    def _tree_url(self) -> str:
        return self.space.container("parameters", names.segments(self.name))

    def state_of(self, value: ParameterValue) -> State:
        """Return the state with this value, which is not a tree. Raises a 406 Problem for a too deeply nested value."""
        graph = self.session.graph
        plain, descriptor, note = self._plain(value), descriptor_of(graph, self.name), self._note(graph)

        def described() -> Document:
            document = parameter_document(self.name, value, self.space)
            declared = () if descriptor is None else declared_triples(descriptor, self.url, self.space)
            noted = triples_about(NamedNode(self.url), (rdfs.comment, text(note)))
            return replace(document, triples=(*document.triples, *declared, *noted))

        note_text = "" if descriptor is None and note is None else repr((descriptor, note))
        token = digest(plain + note_text.encode("utf-8", "surrogatepass"))
        return self.states.get_or_make(self.url, token, lambda: State(described, lambda: plain, token))

    async def forms(self) -> Sequence[Form]:
        methods, value = self.methods(), await self._value()
        forms: list[Form] = []
        if "PUT" in methods and value is not None:
            graph = self.session.graph
            forms.append(parameter_form(plain_value(value), descriptor_of(graph, self.name), self._note(graph)))
        if "DELETE" in methods:
            forms.append(DeleteForm("Delete the parameter"))
        return forms

    async def put(self, exchange: Exchange) -> Answer:
        """Set the parameter: 204, or 201 if it is new, or 200 with the value if the node changed it."""
        value = await self._parse(exchange)
        _require_below(exchange, self.url, value)
        before = await self._value()
        self._check_place(value, before)
        expect_status(201 if before is None else 204)
        await self._set({self.name: value})
        if before is not None:
            return await self._answer({self.name: value})
        if isinstance(value, dict):
            tree = ParameterTree(self.services, names.segments(self.name))
            return CreatedAnswer(tree.url, tree, await tree.state())
        return CreatedAnswer(self.url, self, self.state_of(value))

    async def plan_graph_write(self, triples: Sequence[Triple] | None) -> Plan:
        methods = self.methods()
        body = index_triples(triples or ())
        if not body.objects(NamedNode(self.url), ros.value):
            if "DELETE" not in methods:
                raise self.not_allowed("DELETE", 403)
            self._require_open(self.session.graph, self.name, {})

            async def deleted() -> bool:
                await self._delete([self.name])
                return True

            return RobotWrite(f"delete the parameter {self.name}", deleted)
        if "PUT" not in methods:
            raise self.not_allowed("PUT", 403)
        value = lower_parameter(body, self.url)
        self._check_place(value, await self._value())
        await self._require_settable({self.name: value})

        async def set_to() -> bool:
            await self._set({self.name: value})
            return True

        return RobotWrite(f"set the parameter {self.name} to {parameter_json(value).decode()}", set_to)

    async def _parse(self, exchange: Exchange) -> ParameterValue:
        data = await exchange.body()
        if exchange.media_type == JSON:
            return lower_json(parse_json(data))
        body = parse_body(data, exchange.media_type, self.url)
        descriptor = descriptor_of(self.session.graph, self.name)
        for term in body.objects(NamedNode(self.url), ros.value):
            require_form(descriptor, term)
        return lower_parameter(body, self.url)

    def _check_place(self, value: ParameterValue, before: ParameterValue | None) -> None:
        """Raise a 409 Problem if the value would replace a tree of this name or a parameter above it."""
        if isinstance(before, dict) and before and not isinstance(value, dict):
            raise Problem(
                409, f"{self.name} is a tree of parameters; DELETE {self._tree_url()} first, or choose another name."
            )
        parts, known = names.segments(self.name), self.session.graph.parameters
        for depth in range(1, len(parts)):
            above = names.join(parts[:depth])
            if above in known:
                words = f"{above} is a parameter with a value and cannot have children; DELETE it first."
                raise Problem(409, words, about=(self.space.parameter(above),))

    async def patch(self, exchange: Exchange) -> Answer:
        """Set the patched value: 204, or 200 with the value if the node changed it."""
        before = await self._value()
        if before is None:
            raise Problem(404, f"There is no parameter {self.name}; PUT to create it.")
        data = await exchange.body()
        if exchange.media_type == MERGE_PATCH:
            value = lower_json(merge_patch(parse_json(parameter_json(before)), parse_json(data)))
        else:
            document = parameter_document(self.name, before, self.space)
            value = lower_parameter(apply_update(data, document.triples, self.url, by_value=True), self.url)
        _require_below(exchange, self.url, value)
        self._check_place(value, before)
        expect_status(204)
        await self._set({self.name: value})
        return await self._answer({self.name: value})


class ParameterTree(ParameterContainer):
    """A namespace of parameters, in which clients create, set and delete parameters."""

    accepts: Mapping[str, Sequence[str]] = {"POST": (*RDF_BODIES, JSON), "PATCH": (MERGE_PATCH,)}

    @property
    def changes_subtree(self) -> bool:
        return True

    def path_item(self, schemas: MessageSchemas) -> PathItem:
        return PathItem(
            "A tree of parameters",
            plain=OBJECT,
            query=LISTING_PARAMETERS,
            writes={
                "POST": WriteMethod(
                    "Creates a parameter, named by `Slug` if that is free.", _NEW_VALUE, done=(200, 201, 204)
                ),
                "PATCH": WriteMethod(sends=OBJECT, done=(200, 204)),
                "DELETE": WriteMethod(done=(204,)),
            },
            is_paged=True,
        )

    def methods(self) -> frozenset[str]:
        if not self.session.adapter.capabilities.parameter_trees:
            return READ | {"POST", "PATCH"} if self._can_change_node() else READ
        methods = READ
        if self.allows(Operation.SET_PARAMETER) or (not self.namespace and self._may_create()):
            methods |= {"POST", "PATCH"}
        if self.namespace and self.allows(Operation.DELETE_PARAMETER):
            methods |= {"DELETE"}
        return methods

    def _can_change_node(self) -> bool:
        """Whether this is the container of a node whose parameters can be set."""
        allows = self.session.adapter.allows
        return self.closed_reason is None and any(
            one.node == self.name and Operation.SET_PARAMETER in allows(Ref(Kind.PARAMETER, one.name))
            for one in self.session.graph.parameters.values()
        )

    def _may_create(self) -> bool:
        allowed = self.session.adapter.allows(Ref(Kind.PARAMETER, "/rosld"))
        return Operation.SET_PARAMETER in allowed and not self.session.settings.read_only

    async def select_variant(self, exchange: Exchange) -> Resource:
        """Return the page of `?page=`; redirect from the container to the first of many pages (303)."""
        if exchange.method not in ("GET", "HEAD"):
            return self
        target = self.requested(exchange)
        members = target._listed().members
        if target._place is None and members is not None and not _wants_value(exchange):
            require_page(exchange, self.url, count_members(members))
        return target

    async def post(self, exchange: Exchange) -> Answer:
        """Create a member, named by Slug if that name is free (LDP 5.2.3.10).

        Raises a 404 Problem if there is no such tree.
        """
        if self.namespace and await self._value() is None:
            raise Problem(404, f"There is no tree of parameters {self.name}.")
        member = ParameterResource(self.services, await self._free_name(exchange.header("slug")))
        return await member.put(exchange)

    async def _free_name(self, slug: str | None) -> str:
        stem = "".join(char if char.isalnum() or char == "_" else "_" for char in redact_tokens(slug or "")[:_MAX_SLUG])
        name = names.join((*self.namespace, stem or f"parameter_{secrets.token_hex(3)}"))
        deadline = loop_time() + self.session.settings.call_deadline
        existing = await self.session.adapter.get_parameters([name], deadline=deadline)
        return f"{name}_{secrets.token_hex(3)}" if existing else name

    async def patch(self, exchange: Exchange) -> Answer:
        """Set the members of a merge patch and delete the null ones (RFC 7396); a node's values are set atomically.

        Raises a 422 Problem for a patch that is not an object, 409 for parameters of another node.
        """
        before = await self._value()
        patch = parse_json(await exchange.body())
        if not isinstance(patch, dict) or not isinstance(before, dict | None):
            raise Problem(422, f"A patch of the tree {self.name} must be a JSON object of its members.")
        merged = lower_json(merge_patch(parse_json(parameter_json(before or {})), patch))
        assert isinstance(merged, dict)
        if not self.session.adapter.capabilities.parameter_trees:
            return await self._patch_node(
                dict(leaf_values(self.name, before or {})), dict(leaf_values(self.name, merged))
            )
        gone = [name for name in (before or {}) if name not in merged]
        changed = changed_values(before or {}, merged)
        prefix = "" if self.name == "/" else self.name
        values = {f"{prefix}/{name}": value for name, value in changed.items()}
        with contextlib.suppress(DryRunEnded):
            await self._set(values)
        if gone:
            await self._delete([f"{prefix}/{name}" for name in gone])
        end_dry_run(204)
        return await self._answer(values)

    async def _patch_node(self, before: Mapping[str, ParameterValue], after: Mapping[str, ParameterValue]) -> Answer:
        """Set the changed parameters of this node in one call, then delete the removed ones."""
        changed = changed_values(before, after)
        gone = [name for name in before if name not in after]
        graph = self.session.graph
        for name in (*changed, *gone):
            known = graph.parameters.get(name)
            if known is not None and known.node != self.name:
                about = () if known.node is None else (self.space.node(known.node),)
                words = f"{name} belongs to the node {known.node}: PATCH its own container."
                raise Problem(409, words, about=about)
        for name in gone:
            require_not_fixed(graph, name, delete=True)
        with contextlib.suppress(DryRunEnded):
            if changed:
                await self._set(changed)
        if gone:
            await self._delete(gone)
        end_dry_run(204)
        return await self._answer(changed)


def _require_below(exchange: Exchange, url: str, value: ParameterValue) -> None:
    """Raise a Problem for a tree unless the agent may write the whole subtree."""
    place = exchange.permissions.locate(url)
    if isinstance(value, dict) and place is not None:
        require_subtree(exchange.permissions, exchange.method, place)


def _wants_value(exchange: Exchange) -> bool:
    """Whether a request prefers the value of a tree, as JSON or as a stream, to the container."""
    return exchange.preferred({"json": JSON}, (*OFFERS, EVENT_STREAM)) in (JSON, EVENT_STREAM)
