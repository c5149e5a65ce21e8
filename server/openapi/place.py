"""What there is to be described, as values: the places of a server and what is said of each."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from rosld.server.hypermedia.json_schema import TEXT, Schema
from rosld.server.rest.formats import OFFERS


@dataclass(frozen=True, slots=True)
class Query:
    """A parameter of the query."""

    name: str
    about: str
    schema: Schema = field(default_factory=lambda: TEXT)
    required: bool = False
    of: frozenset[str] = frozenset()
    """The methods beside GET and HEAD that take it."""
    of_reads: bool = True
    """Whether GET and HEAD take it."""


@dataclass(frozen=True, slots=True)
class Place:
    """A URL, or a template of URLs, and what it answers.

    `path` lies below the base and begins with a slash; it is encoded as in the URL, and names in braces stand for
    segments, each told of in `segments`. `accepts` are the media types that a method takes, `sends` the schemas of its
    JSON; methods in `optional` do without a body, too. `reads` are the media types that GET answers with; `plain` is
    the schema of `application/json` among them (JSON-LD where there is none). `done` are the statuses of what a method
    has done, where they are not the usual ones; `shows` is what then comes as `application/json`. `streams`: its
    changes can be had as an event stream. `also` are statuses of refusals that most places do not have. Places `alike`
    (a name such as "parameter") are described once: robots have thousands of them.
    """

    path: str
    tag: str
    summary: str
    methods: frozenset[str]
    reads: tuple[str, ...]
    accepts: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    sends: Mapping[str, Schema] = field(default_factory=dict)
    optional: frozenset[str] = frozenset()
    plain: Schema | None = None
    done: Mapping[str, tuple[int, ...]] = field(default_factory=dict)
    shows: Mapping[str, Schema] = field(default_factory=dict)
    query: tuple[Query, ...] = ()
    segments: Mapping[str, str] = field(default_factory=dict)
    streams: bool = True
    also: tuple[int, ...] = ()
    alike: str | None = None
    pages: bool = False
    """Whether it is a container that may come in pages: GET then takes `page` and the preferences of LDP."""
    members: Mapping[str, str] = field(default_factory=dict)
    """The URLs of what the members of its JSON are the values of, by their names: who may not read one is not told."""
    notes: Mapping[str, str] = field(default_factory=dict)
    """A sentence for a method, where its summary does not say enough."""

    @property
    def is_document(self) -> bool:
        """Whether it is RDF and nothing else."""
        return self.plain is None and self.streams and self.reads == OFFERS
