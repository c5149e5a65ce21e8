"""Paths of the description: URLs and templates with their operations (OpenAPI 3.1.1, 4.8.8)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import suppress
from itertools import chain, islice

from msgspec import Struct, field
from msgspec.structs import replace

from rosld.adapters.model import Graph, names
from rosld.ontology.describe_body import body_sources
from rosld.ontology.notifications import CHANNEL_TYPES
from rosld.server.http.problem import Problem
from rosld.server.hypermedia.conditions import url_of
from rosld.server.hypermedia.json_schema import MessageSchemas
from rosld.server.hypermedia.resource_tree import ResourceTree
from rosld.server.resources.base import Services
from rosld.server.resources.channels import ChannelResource, ChannelSourceResource
from rosld.server.resources.namespaces import namespaces
from rosld.server.resources.types import SHAPES_GRAPHS
from rosld.server.rest.path_item import ANY_TYPE, FIELD_READS, FORMAT, PathItem, WriteMethod
from rosld.server.rest.resource import Resource


class DescribedPath(Struct, frozen=True):
    """The description of `template`, which is relative to the base, begins with a slash and is percent-encoded.

    Names in braces stand for segments, which `segments` describes. `accepts` has the media types that each of the
    `methods` accepts.
    """

    template: str
    tag: str
    item: PathItem
    methods: frozenset[str]
    accepts: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    segments: Mapping[str, str] = field(default_factory=dict)

    def write(self, method: str) -> WriteMethod:
        """Return the description of a method that writes."""
        return self.item.write(method)


MAX_SINGLE = 1000
"""Maximum number of parameters and of complex resources described individually; templates cover the rest."""
_MAX_QUERIES = 1000
_OR_ANOTHER = f", or one that is not among the {MAX_SINGLE} described individually"
_TAGS = {
    "": "entry",
    "find": "entry",
    "plot": "entry",
    "space": "entry",
    "frames": "entry",
    "body": "entry",
    "graph": "entry",
    "diagnostics": "entry",
    "sparql": "queries",
    "graphs": "queries",
    "mirror": "queries",
    ".well-known/solid": "channels",
    "metrics": "status",
    "healthz": "status",
    "readyz": "status",
}
"""Tags of URLs that are not named after their first segment."""
_ENTRY = (
    "ontology",
    ".well-known/",
    ".well-known/wot",
    ".well-known/void",
    "openapi.json",
    "asyncapi.json",
    "llms.txt",
)
_NAME = "A name, as in the URL: its parts are separated by slashes."


class PathCollector(Struct, frozen=True):
    """Collector of the paths.

    `graph` is the computation graph; `hidden`: whether to include hidden names of resources.
    """

    services: Services
    graph: Graph
    tree: ResourceTree
    schemas: MessageSchemas
    hidden: bool

    def all(self) -> Iterator[DescribedPath]:
        """Yield every path except those of the scripts, styles and icons of pages."""
        yield self._path("/")
        yield from self._graph()
        yield from self._parameters()
        yield from self._resources()
        yield from self._types()
        yield from self._bags()
        yield from self._stored_paths()
        yield from self._queries()
        yield from self._channels()
        yield from self._activities()
        for path in (
            "find",
            "graph",
            "diagnostics",
            "plot",
            "space",
            "frames",
            "stop",
            "status",
            "metrics",
            "healthz",
            "readyz",
            "sparql",
            "graphs",
            *_ENTRY,
        ):
            yield self._path(f"/{path}")
        if body_sources(self.graph):
            yield self._path("/body")
        with suppress(Problem):  # only exists if it is configured
            yield self._path("/mirror")
        with suppress(Problem):  # packagers may leave the documentation out
            yield self._path("/docs/")
            yield self._template("/docs/{folder}/{page}", "/docs/how-to/trouble", folder="A folder.", page="A page.")

    def some(self, paths: Mapping[str, str]) -> Iterator[DescribedPath]:
        """Yield these paths and templates, each described by the resource at an example path."""
        for template, example in paths.items():
            yield self._template(template, example)

    def _path(self, path: str) -> DescribedPath:
        """Return a path described by its resource."""
        resource = self.services.find(path)
        return self._describe(path, resource, resource.path_item(self.schemas))

    def _template(self, template: str, example: str, *, item: PathItem | None = None, **segments: str) -> DescribedPath:
        """Return a template described by the resource at an example path."""
        resource = self.services.find(example)
        found = self._describe(template, resource, item or resource.path_item(self.schemas))
        return replace(found, segments=segments)

    def _describe(self, path: str, resource: Resource, item: PathItem) -> DescribedPath:
        methods = resource.methods() if item.methods is None else item.methods
        own = {method: each.accepts for method, each in item.writes.items() if each.accepts is not None}
        accepts = {method: tuple(kinds) for method, kinds in {**resource.accepts, **own}.items() if method in methods}
        return DescribedPath(path, self._tag(path[1:]), item, methods, accepts)

    def _tag(self, path: str) -> str:
        if path in _ENTRY or path.startswith("docs/"):
            return "entry"
        return _TAGS.get(path) or path.partition("/")[0]

    def _of(self, url: str) -> str:
        return url[len(self.services.space.base) - 1 :]

    # The computation graph

    def _graph(self) -> Iterator[DescribedPath]:
        graph, space = self.graph, self.services.space
        for route in ("nodes", "topics", "services", "actions"):
            for namespace in namespaces(graph, route):
                yield self._path(self._of(space.container(route, namespace)))
        urls = chain(
            map(space.node, graph.nodes),
            map(space.topic, graph.topics),
            map(space.service, graph.services),
            map(space.action, graph.actions),
        )
        for url in urls:
            yield self._path(self._of(url))
        yield self._template("/topics/{name}", "/topics/new", name=_NAME)
        for route, word in (("calls", "call"), ("goals", "goal"), ("holds", "hold"), ("faults", "fault")):
            yield self._path(f"/{route}/")
            yield self._template(f"/{route}/{{id}}", f"/{route}/any", id=f"As in the URL of the {word}.")

    def _activities(self) -> Iterator[DescribedPath]:
        yield self._path("/activity/")
        yield self._template("/activity/{id}", "/activity/any", id="As in the URL of the receipt.")

    def _parameters(self) -> Iterator[DescribedPath]:
        graph, space = self.graph, self.services.space
        trees = dict.fromkeys([(), *namespaces(graph, "parameters")])
        for namespace in islice((each for each in trees if "" not in each), MAX_SINGLE):
            yield self._path(self._of(space.container("parameters", namespace)))
        for name in islice((each for each in graph.parameters if "" not in names.segments(each)), MAX_SINGLE):
            yield self._path(self._of(space.parameter(name)))
        summary = "A parameter that can be created" + ("" if len(graph.parameters) <= MAX_SINGLE else _OR_ANOTHER)
        item = self.services.find("/parameters/new").path_item(self.schemas)
        item = replace(item, summary=summary)
        yield self._template("/parameters/{name}", "/parameters/new", item=item, name=_NAME)

    # Levels two and three

    def _resources(self) -> Iterator[DescribedPath]:
        found = (path for path in self._resource_paths() if self.hidden or not names.is_hidden(path))
        for path in islice(found, MAX_SINGLE):
            yield self._path(path)
        if (another := next(found, None)) is not None:
            yield self._other_resources(self._path(another))

    def _resource_paths(self) -> Iterator[str]:
        """Yield the complex resources, each followed by its properties and actions, then the other actions."""
        space = self.services.space
        unlisted = set(self.tree.actions)
        for path in self.tree.paths:
            plan = self.tree.complex(path)
            if plan is not None:
                yield self._of(url_of(path, space))
                properties = [one.url_name for one in plan.members if one.url_name is not None]
                for name in dict.fromkeys((*properties, *(one.name for one in plan.actions))):
                    unlisted.discard(name)
                    yield self._of(url_of(name, space))
        for name in sorted(unlisted):
            if self.tree.action(name) is not None:
                yield self._of(url_of(name, space))

    def _other_resources(self, one: DescribedPath) -> DescribedPath:
        """Return the template for all resources and properties not described individually, based on an example."""
        summary = "Any resource, property or action that is not described individually"
        accepts = dict.fromkeys(one.accepts, (ANY_TYPE,))
        segments = {"name": "A path, as in links."}
        item = PathItem(summary, FIELD_READS, query=(FORMAT,))
        return DescribedPath("/resources/{name}", "resources", item, one.methods, accepts, segments)

    # Everything else

    def _types(self) -> Iterator[DescribedPath]:
        package, kind, name = "A package.", "`msg`, `srv` or `action`.", "The name of a type."
        for route in ("types", "shapes"):
            yield self._path(f"/{route}/")
            yield self._template(f"/{route}/{{package}}/", f"/{route}/a/", package=package)
            yield self._template(f"/{route}/{{package}}/{{kind}}/", f"/{route}/a/msg/", package=package, kind=kind)
            one = f"/{route}/{{package}}/{{kind}}/{{name}}"
            yield self._template(one, f"/{route}/a/msg/B", package=package, kind=kind, name=name)
        for path in SHAPES_GRAPHS:
            yield self._path(f"/shapes/{path}")
        yield self._template("/shapes/{name}", "/shapes/any", name="One segment, as in the URL.")

    def _bags(self) -> Iterator[DescribedPath]:
        space = self.services.space
        yield self._path("/bags/")
        yield self._template("/bags/{name}", "/bags/any", name="Its name in the URL.")
        readable, few = self.services.recordings.readable, self.services.recordings.few
        if (example := next((each for each in readable if each not in few), None)) is not None:
            for below in ("", "file", "at", "ldes", "messages/"):
                path = self._of(f"{space.bag(example)}{below}")
                yield self._template(f"/bags/{{name}}/{below}", path, name="Its name in the URL.")
            template, path = "/bags/{name}/messages/{index}", self._of(space.bag_message(example, 0))
            yield self._template(template, path, name="Its name in the URL.", index="From 0 to the last.")
        for name, recording in few.items():
            yield self._path(self._of(space.bag(name)))
            if recording.path.is_file():
                yield self._path(self._of(f"{space.bag(name)}file"))
            stream = self._of(space.bag_stream(name))
            yield self._path(stream)
            yield self._path(self._of(space.bag_moment(name)))
            if recording.count:
                page = f"{recording.identity}-0-{recording.first // 100}"
                yield self._template(f"{stream}/{{page}}", f"{stream}/{page}", page="As in the links of the stream.")
            path = self._of(space.bag_messages(name))
            yield self._path(path)
            if recording.count:
                first, last = recording.first, recording.first + recording.count - 1
                yield self._template(f"{path}{{index}}", f"{path}{first}", index=f"From {first} to {last}.")

    def _stored_paths(self) -> Iterator[DescribedPath]:
        """Yield the paths of stored resources. The template covers URLs whose methods depend on their existence."""
        yield self._path("/cockpit/default")
        for route in ("mappings", "data", "cockpit"):
            yield self._path(f"/{route}/")
            path = "One segment or several, with slashes between them."
            yield self._template(f"/{route}/{{path}}", f"/{route}/any", path=path)

    def _queries(self) -> Iterator[DescribedPath]:
        """Yield `/queries/` and the current paths below it; the template covers all others."""
        yield self._path("/queries/")
        for url, _ in self.services.queries.all(limit=_MAX_QUERIES):
            yield self._path(self._of(url))
        yield self._template("/queries/{name}", "/queries/any", name="One segment, as in the URL.")

    def _channels(self) -> Iterator[DescribedPath]:
        """Yield the paths of notifications (Solid Notifications Protocol 2)."""
        yield self._path("/.well-known/solid")
        yield self._path("/channels/")
        for kind in CHANNEL_TYPES:
            path = f"/channels/{kind}"
            yield self._path(path)
            token = "As in the URL of the channel."
            yield replace(self._template(f"{path}/{{token}}", path, item=ChannelResource.item, token=token), accepts={})
            source = self._template(f"{path}/{{token}}/messages", path, item=ChannelSourceResource.item, token=token)
            yield replace(source, accepts={})
