"""Base classes of resources with a ROS name in the computation graph, and of temporary ones with an identifier."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from operator import attrgetter
from typing import Any, ClassVar, Generic, TypeVar

from rosld.adapters.base import Watch
from rosld.adapters.model import Graph, Kind, Operation, Ref
from rosld.ontology.urls import Space
from rosld.server.http.problem import READ_ONLY, Problem
from rosld.server.resources.accepted_shape import CommandResource
from rosld.server.resources.base import Services, SessionResource
from rosld.server.resources.namespaces import redirect_to_namespace
from rosld.server.robot.write_policy import resources_only_reason

T = TypeVar("T")


class NamedResource(CommandResource, Generic[T]):
    """Base class of nodes, topics, services, actions and parameters."""

    ros_kind: Kind
    url_of: ClassVar[Callable[[Space, str], str]]

    def __init__(self, services: Services, name: str) -> None:
        super().__init__(services, type(self).url_of(services.space, name))
        self.name = self.title = name
        self._route = f"{self.ros_kind.value}s"

    @property
    def found(self) -> T | None:
        """The entry of the computation graph, or None."""
        return self.found_in(self.session.graph)

    def found_in(self, graph: Graph) -> T | None:
        """Return the entry of a graph."""
        things: Mapping[str, T] = getattr(graph, self._route)
        return things.get(self.name)

    def require(self, graph: Graph | None = None) -> T:
        """Return the entry of a graph, by default the current one. Raises a 404 Problem, or 308 for a namespace."""
        found = self.found_in(self.session.graph if graph is None else graph)
        if found is None:
            raise self.missing()
        return found

    def missing(self) -> Problem:
        """Return the Problem of a name that does not exist: 308 for a namespace, else 404."""
        return self._redirect() or Problem(404, f"There is no {self.ros_kind.value} {self.name}.")

    @property
    def is_absent(self) -> bool:
        return self.found is None and self._redirect() is None

    def _redirect(self) -> Problem | None:
        return redirect_to_namespace(self.space, self.session.graph, self._route, self.name)

    @property
    def closed_reason(self) -> str | None:
        """A sentence why this server allows no writes here, or None."""
        if self.session.settings.read_only:
            return READ_ONLY
        return resources_only_reason(self.name) if self.session.is_resources_only(self.name) else None

    def allows(self, operation: Operation) -> bool:
        """Whether both this server and the robot allow an operation."""
        return self.closed_reason is None and operation in self.session.adapter.allows(Ref(self.ros_kind, self.name))


class KeptResource(SessionResource, Generic[T]):
    """Base class of calls, goals, holds and faults, which are in a store of the services."""

    links_offer = True
    url_of: ClassVar[Callable[[Space, str], str]]
    store_of: ClassVar[attrgetter[Any]]
    title_of: ClassVar[attrgetter[str]] = attrgetter("id")

    def __init__(self, services: Services, id: str) -> None:
        super().__init__(services, type(self).url_of(services.space, id))
        self.store = self.store_of(services)
        self.id = self.title = id
        with suppress(LookupError):
            self.title = self.title_of(self.store.find(id))

    async def watch(self, wake: Callable[[], None]) -> Watch:
        watched: Watch = self.store.changes.watch(wake, lambda about: about == self.id)
        return watched

    def require(self) -> T:
        """Return the current state of the call, goal or hold. Raises a 404 or 410 Problem."""
        what = f"{self.kind.lower()} {self.id}"
        try:
            found: T = self.store.find(self.id)
            return found
        except KeyError as error:
            raise Problem(404, f"There is no {what}.") from error
        except LookupError as error:
            raise Problem(410, f"The {what} {self.gone_words(error)}.") from error

    def gone_words(self, error: LookupError) -> str:
        """Return the reason for the removal, to follow the name in a sentence."""
        return "was deleted or is too old"

    @property
    def is_absent(self) -> bool:
        try:
            self.store.find(self.id)
        except LookupError:
            return True
        return False
