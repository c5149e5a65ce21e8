"""Factory of the resources of one robot, each created with the services that it needs."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from starlette.types import Scope

from rosld.adapters.base import Recording
from rosld.ontology.urls import Location
from rosld.server.html.page import StoredQueryLink
from rosld.server.http.problem import Problem
from rosld.server.hypermedia.brief_value import LatestValues
from rosld.server.hypermedia.resource_tree import path_of
from rosld.server.openapi.openapi_resource import OpenApiResource
from rosld.server.resources.actions import ActionResource, GoalResource
from rosld.server.resources.activities import ActivityContainer, ActivityResource
from rosld.server.resources.bag_messages import BagMessage
from rosld.server.resources.bag_routes import bag_route
from rosld.server.resources.bags import Bags
from rosld.server.resources.cockpit_panels import CockpitSources, QueryTables
from rosld.server.resources.cockpits import cockpit_route
from rosld.server.resources.complex_resource import ComplexResource
from rosld.server.resources.diagnostics import DiagnosticsResource
from rosld.server.resources.entry_point import EntryResource, GuideResource
from rosld.server.resources.find import FindResource
from rosld.server.resources.finder import Finder
from rosld.server.resources.graph import GraphResource
from rosld.server.resources.graph_store import GraphStore
from rosld.server.resources.holds import HoldResource
from rosld.server.resources.ldp.routes import stored_route
from rosld.server.resources.limit_checks import LimitChecks
from rosld.server.resources.listings import ListingResource, calls_listing, goals_listing, holds_listing
from rosld.server.resources.namespaces import NamespaceContainer
from rosld.server.resources.nodes import NodeResource
from rosld.server.resources.ontology import OntologyResource, ontology_route
from rosld.server.resources.parameters import ParameterResource, ParameterTree
from rosld.server.resources.property_action import MemberResource
from rosld.server.resources.queries import QueryRunner, query_route
from rosld.server.resources.recording_trigger import RecordingTriggers
from rosld.server.resources.services import CallResource, ServiceResource
from rosld.server.resources.sparql_endpoint import SparqlResource
from rosld.server.resources.stop import StopResource
from rosld.server.resources.things import RobotThing, ThingDescriptions
from rosld.server.resources.topics import TopicResource
from rosld.server.resources.types import ShapeResource, TypeResource, shape_route, type_route
from rosld.server.rest.pages import PageRenderer
from rosld.server.rest.resource import Resource, permanent_redirect
from rosld.server.robot.diagnostic_states import LevelTimes
from rosld.server.routing.services import Services
from rosld.server.sparql.query_service import QueryService
from rosld.server.sparql.update.base import UpdateRunner

Find = Callable[[str], Resource]
"""Function that returns the resource at a path below the base."""
_EXAMPLES = 100
"""Number of stored queries that the page of the endpoint lists."""


class ResourceFactory:
    """Factory of the resources of one robot, from a name or a location.

    The methods that take a location raise Problems: 404, or 308 if only the final slash differs.
    """

    def __init__(self, services: Services) -> None:
        self.services = services
        self.session = services.session
        self.states = services.states
        self.affordances = services.affordances
        self.history = services.recordings.history
        session = self.session
        self.limit_checks = LimitChecks(
            session.space,
            session.lifting,
            session.adapter,
            services.affordances,
            services.active_limits,
            session.settings.allow_non_finite,
        )
        self._things = ThingDescriptions(
            services.session, services.affordances, services.software_stop, services.instance_id
        )
        self._bags = Bags(services.session, self.states, services.recordings, services.pictures)
        self._latest_values = LatestValues(services.session.topics, services.session.schemas)
        self._level_times = LevelTimes()
        self._query_tables = QueryTables()

    # --- computation graph

    def entry(self) -> EntryResource:
        services = self.services
        return EntryResource(self.session, self.states, services.recordings, services.problems)

    def node(self, name: str) -> NodeResource:
        return NodeResource(self.session, self.limit_checks, self.states, name)

    def topic(self, name: str, find: Find | None = None) -> TopicResource:
        """Return a topic; `find` returns the resource that a request to the topic names."""
        services = self.services
        return TopicResource(
            self.session,
            self.limit_checks,
            self.states,
            self.history,
            services.holds,
            services.pictures,
            name,
            find,
        )

    def service(self, name: str) -> ServiceResource:
        return ServiceResource(self.session, self.limit_checks, self.states, name)

    def action(self, name: str) -> ActionResource:
        return ActionResource(self.session, self.limit_checks, self.states, name)

    def parameter(self, name: str) -> ParameterResource:
        return ParameterResource(self.session, self.limit_checks, self.states, name)

    def parameter_tree(self, path: tuple[str, ...]) -> ParameterTree:
        return ParameterTree(self.session, self.limit_checks, self.states, path)

    def parameter_at(self, location: Location) -> Resource:
        """Return a parameter, or a tree of parameters if the location ends in a slash."""
        name = location.name
        if "" in location.segments:
            raise Problem(404, f"No parameter is called {name}: none has a part that is empty.")
        if location.is_container:
            return self.parameter_tree(location.segments)
        if not location.segments:
            raise permanent_redirect(self.session.space.container("parameters"))
        return self.parameter(name)

    def namespace(self, kind: str, path: tuple[str, ...]) -> NamespaceContainer:
        return NamespaceContainer(self.session, self.states, self._latest_values, kind, path)

    def graph(self) -> GraphResource:
        return GraphResource(self.session, self.services.instance_id)

    def diagnostics(self) -> DiagnosticsResource:
        return DiagnosticsResource(self.session, self.history, self._level_times)

    def type(self, name: str) -> TypeResource:
        return TypeResource(self.session, self.states, name)

    def shape(self, name: str) -> ShapeResource:
        return ShapeResource(self.session.space, self.session.schemas, self.states, name)

    def type_at(self, location: Location) -> Resource:
        return type_route(self.session, self.states, location)

    def shape_at(self, location: Location) -> Resource:
        return shape_route(self.session, self.affordances, self.limit_checks, self.services.documents, location)

    # --- resources created by use

    def call(self, id: str) -> CallResource:
        return CallResource(self.session, self.states, id)

    def goal(self, id: str) -> GoalResource:
        return GoalResource(self.session, self.states, id)

    def hold(self, id: str, find: Find | None = None) -> HoldResource:
        return HoldResource(self.session, self.limit_checks, self.states, self.services.holds, id, find)

    def calls(self) -> ListingResource:
        return calls_listing(self.session.space, self.session.calls, self.states)

    def goals(self) -> ListingResource:
        return goals_listing(self.session.space, self.session.goals, self.states)

    def holds(self) -> ListingResource:
        return holds_listing(self.session.space, self.states, self.services.holds)

    def stop(self) -> StopResource:
        return StopResource(self.session.space, self.states, self.services.software_stop)

    def activity(self, id: str) -> ActivityResource:
        session = self.session
        return ActivityResource(session.space, session.settings, self.states, self.services.receipts, id)

    def activities(self) -> ActivityContainer:
        return ActivityContainer(self.session.space, self.states, self.services.receipts)

    # --- resources of levels two and three

    def complex(self, path: str) -> ComplexResource:
        return ComplexResource(
            self.session, self.affordances, self.limit_checks, self._things, self.states, self.history, path
        )

    def member(self, name: str) -> MemberResource:
        return MemberResource(
            self.session, self.affordances, self.limit_checks, self._things, self.states, self.history, name
        )

    def resource_at(self, location: Location) -> Resource:
        """Return a resource below `/resources/`."""
        if location.is_container:
            return self.complex(path_of(location.segments))
        if not location.segments:
            raise permanent_redirect(self.session.space.container("resources"))
        if not location.segments[-1]:
            raise Problem(404, f"No resource is called {location.name}: its own name would be empty.")
        return self.member(location.name)

    def robot_thing(self, location: Location) -> RobotThing:
        """Return the Thing Description of the robot at `/.well-known/wot`. Raises a 404 Problem for other locations."""
        space = self.session.space
        if location.segments != ("wot",) or location.is_container:
            raise Problem(404, f"It is not among what is well known here: {space.base}.well-known/ lists that.")
        return RobotThing(space, self.affordances, self._things)

    # --- recordings and stored documents

    def bag_at(self, location: Location, triggers: RecordingTriggers | None = None) -> Resource:
        """Return a recording, a part of one, or their container; `triggers` follows conditions of armed recordings."""
        return bag_route(self._bags, location, triggers)

    def bag_message(self, recording: Recording, index: int) -> BagMessage:
        return BagMessage(self._bags, recording, index)

    def document_at(self, location: Location) -> Resource:
        return stored_route(self.services.documents, location)

    def query_at(self, location: Location, runner: QueryRunner) -> Resource:
        return query_route(self.services.documents, self.services.queries, location, runner=runner)

    def cockpit_at(self, location: Location, service: QueryService, find: Find) -> Resource:
        services = self.services
        sources = CockpitSources(
            self.session,
            self.affordances,
            services.documents,
            services.queries,
            self.history,
            services.software_stop,
            service,
            find,
            self._query_tables,
        )
        return cockpit_route(sources, location)

    # --- singletons

    def ontology_module(self, name: str) -> OntologyResource:
        return OntologyResource(self.session.space, self.states, name)

    def ontology_at(self, location: Location) -> Resource:
        return ontology_route(self.session.space, self.states, location)

    def guide(self) -> GuideResource:
        session = self.session
        return GuideResource(session.space, session.name, read_only=session.settings.read_only)

    def openapi(self, resolve: Find) -> OpenApiResource:
        services = self.services
        return OpenApiResource(
            self.session,
            self.affordances,
            services.documents.workers,
            services.queries,
            services.mappings,
            services.recordings,
            services.instance_id,
            resolve,
        )

    def search(self) -> FindResource:
        services = self.services
        finder = Finder(self.session, self.affordances, services.documents, services.queries)
        return FindResource(self.session, self.affordances, self._latest_values, services.property_reader, finder)

    def graph_store(
        self, service: QueryService, resolve: Callable[[Scope], Resource], updates: UpdateRunner | None
    ) -> GraphStore:
        return GraphStore(self.session.space, self.session.settings, self.states, service, resolve, updates)

    def sparql_endpoint(
        self, service: QueryService, pages: PageRenderer, updates: UpdateRunner | None
    ) -> SparqlResource:
        session = self.session
        examples = partial(_examples, self.services)
        return SparqlResource(session.space, session.settings, self.states, service, pages, examples, updates)


def _examples(services: Services) -> list[StoredQueryLink]:
    """Return example queries: all shipped ones, and some of the stored ones."""
    found = services.queries.all(limit=_EXAMPLES)
    return [StoredQueryLink(url, query.name, query.purpose, query.text) for url, query in found]
