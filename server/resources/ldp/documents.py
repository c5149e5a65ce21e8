"""The documents that clients keep, and the services with which their resources read and write them."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Mapping, Sequence
from dataclasses import dataclass

from rosld.ontology.urls import Space
from rosld.server.resources.ldp.validation import Validator
from rosld.server.rest.state import State
from rosld.server.runtime.offload import WorkerPool
from rosld.server.runtime.tasks import Signal
from rosld.server.runtime.version_cache import VersionCache
from rosld.server.settings import Settings
from rosld.server.storage.sqlite import Records


@dataclass(frozen=True, slots=True)
class Documents:
    """The records, and the services with which resources read and write them."""

    space: Space
    settings: Settings
    records: Records
    changes: Signal
    """Emits the path of each record that has changed."""
    states: VersionCache[State]
    workers: WorkerPool
    validators: Mapping[str, Validator]
    """By the route below which a document has an effect."""
    mapping_warnings: Callable[[str], Awaitable[Sequence[str]]]
    """Tells what the mapping at a URL names in vain, in sentences."""

    def validator_of(self, path: str) -> Validator | None:
        """Who judges what is kept at a path; nobody, for most."""
        route = path[: path.find("/") + 1]
        return None if path == route else self.validators.get(route)
