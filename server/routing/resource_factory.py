"""Factory of the resources of one robot, each created with the services that it needs."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

from rosld.server.hypermedia.brief_value import LatestValues
from rosld.server.resources.actions import GoalResource
from rosld.server.resources.bags import Bags
from rosld.server.resources.complex_resource import ComplexResource
from rosld.server.resources.graph import GraphResource
from rosld.server.resources.holds import HoldResource
from rosld.server.resources.limit_checks import LimitChecks
from rosld.server.resources.listings import ListingResource, calls_listing, goals_listing, holds_listing
from rosld.server.resources.namespaces import NamespaceContainer
from rosld.server.resources.parameters import ParameterTree
from rosld.server.resources.property_action import MemberResource
from rosld.server.resources.services import CallResource
from rosld.server.resources.stop import StopResource
from rosld.server.resources.things import ThingDescriptions
from rosld.server.resources.topics import TopicResource
from rosld.server.rest.resource import Resource
from rosld.server.rest.state import State
from rosld.server.robot.session import Session
from rosld.server.routing.services import Services
from rosld.server.runtime.version_cache import VersionCache

Find = Callable[[str], Resource]
"""Function that returns the resource at a path below the base."""
R = TypeVar("R")


class ResourceFactory:
    """Factory of the resources of one robot that several callers need."""

    find: Find
    """Finds the resource at a path below the base; set by the router."""

    def __init__(self, services: Services) -> None:
        self.services = services
        self.session = services.session
        self.states = services.states
        self.affordances = services.affordances
        self.history = services.recordings.history
        session = self.session
        self.limit_checks = LimitChecks(session, services.affordances, services.active_limits)
        self.things = ThingDescriptions(session, services.affordances, services.software_stop, services.instance_id)
        self.bags = Bags(session, self.states, services.recordings, services.pictures)
        self.latest_values = LatestValues(session.topics, session.schemas)

    def named(self, kind: Callable[[Session, LimitChecks, VersionCache[State], str], R], name: str) -> R:
        """Return a node, a service, an action or a parameter."""
        return kind(self.session, self.limit_checks, self.states, name)

    def topic(self, name: str) -> TopicResource:
        services = self.services
        return TopicResource(
            self.session,
            self.limit_checks,
            self.states,
            self.history,
            services.holds,
            services.pictures,
            name,
            self.find,
        )

    def parameter_tree(self, path: tuple[str, ...]) -> ParameterTree:
        return ParameterTree(self.session, self.limit_checks, self.states, path)

    def namespace(self, kind: str, path: tuple[str, ...]) -> NamespaceContainer:
        return NamespaceContainer(self.session, self.states, self.latest_values, kind, path)

    def graph(self) -> GraphResource:
        return GraphResource(self.session, self.services.instance_id)

    def call(self, id: str) -> CallResource:
        return CallResource(self.session, self.states, id)

    def goal(self, id: str) -> GoalResource:
        return GoalResource(self.session, self.states, id)

    def hold(self, id: str) -> HoldResource:
        return HoldResource(self.session, self.limit_checks, self.states, self.services.holds, id, self.find)

    def calls(self) -> ListingResource:
        return calls_listing(self.session.space, self.session.calls, self.states)

    def goals(self) -> ListingResource:
        return goals_listing(self.session.space, self.session.goals, self.states)

    def holds(self) -> ListingResource:
        return holds_listing(self.session.space, self.states, self.services.holds)

    def stop(self) -> StopResource:
        return StopResource(self.session.space, self.states, self.services.software_stop)

    def complex(self, path: str) -> ComplexResource:
        return ComplexResource(
            self.session, self.affordances, self.limit_checks, self.things, self.states, self.history, path
        )

    def member(self, name: str) -> MemberResource:
        return MemberResource(
            self.session, self.affordances, self.limit_checks, self.things, self.states, self.history, name
        )
