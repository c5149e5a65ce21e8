"""rosld as a client of a ROS 1 system: all work on the reading thread, and the polling of the master."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Iterable, Mapping, Sequence

from rosld.adapters.base import AdapterOptions, Sink
from rosld.adapters.model import Graph, Master, RosError, TimedOut, TypeRef, Unreachable
from rosld.adapters.model.library import TypeLibrary
from rosld.adapters.model.parameter import ParameterValue
from rosld.adapters.ros1.actions import Actions
from rosld.adapters.ros1.graph import SystemState, compose
from rosld.adapters.ros1.master import Hosts, MasterApi, MasterSnapshot, StaleRegistrations
from rosld.adapters.ros1.parameters import Parameters, parts_of, with_parts
from rosld.adapters.ros1.publication import Publication
from rosld.adapters.ros1.publications import Publications, addresses
from rosld.adapters.ros1.reconfigurable import Reconfigurables
from rosld.adapters.ros1.services import Services
from rosld.adapters.ros1.sources import Nodes, TopicReader
from rosld.adapters.ros1.subscription import TopicFeed
from rosld.adapters.ros1.types import EndpointFacts, Facts, Types
from rosld.adapters.ros1.xmlrpc import XmlRpcClient
from rosld.adapters.thread import Tasks, wait_event

_EVERY = 1.0
_SELDOM = 30.0
_SHARE = 20  # a poll may take this fraction of our time and the master's
_LOOK_UPS = 8
_SOON = 0.1
_FIRST_PATIENCE = 1.0
"""Seconds that opening waits for nodes' declarations, and for the removal of a dead rosld's registrations."""


class Client:
    """Polls the master, reads and publishes topics, calls services. Used on the reading thread, except for `graph`."""

    def __init__(
        self, uri: tuple[str, int], own_node: str, options: AdapterOptions, library: TypeLibrary, publish_graph: Sink
    ) -> None:
        host, port = self._address = uri
        self.graph = Graph(0, master=Master(f"http://{host}:{port}"), own_node=own_node)
        self._sink = publish_graph
        self._own_node = own_node
        self._hosts = Hosts(options.host_map, host)
        client = XmlRpcClient(f"http://{host}:{port}", "/RPC2", self._dial, keep_alive=True)
        self.master = MasterApi(client, own_node)
        self.facts = Facts(self.refresh_soon)
        self.types = Types(library, self.refresh_soon)
        self.parameters = Parameters(self.master, self._parameters_changed)
        self.services = Services(own_node, self.master, self._hosts, self.types, self.facts, options.message_limit)
        self.call = self.services.call
        self.publications = Publications(
            self.master, own_node, self.types, lambda: addresses(options.ros_ip, self._local), self.poll_soon
        )
        self._nodes = Nodes(own_node, self._hosts, self.facts, self.master.lookup_node, options.message_limit)
        self.actions = Actions(
            own_node, self._nodes, self.types, self.publications, lambda: self._system, publish_graph
        )
        self.reconfigurables = Reconfigurables(
            self._nodes, self.types, self.services, self.refresh_soon, self._parameters_changed
        )
        self._leftovers = StaleRegistrations(self.master, self._hosts, own_node, lambda: self.publications.uri)
        self._readers: dict[str, TopicReader] = {}
        self._epochs: dict[str, int] = {}
        self._local: str | None = None
        self._snapshot: MasterSnapshot | None = None
        self._system = SystemState()
        self._identity: tuple[int, ParameterValue | None] | None = None
        self._poll_requested = asyncio.Event()
        self._refreshing = False
        self._removals, self._tasks = Tasks(), Tasks()
        self._checked: dict[str, float] = {}
        self._poll_lock = asyncio.Lock()

    async def open(self, patience: float) -> None:
        """Poll for the first time, for at most `patience` seconds, and start polling.

        If the robot is off, the graph is Stale until its master responds.
        """
        try:
            await asyncio.wait_for(self._first_poll(), patience)
        except asyncio.TimeoutError:
            self._mark_stale(TimedOut(f"the ROS 1 master at {self.master.uri} does not answer in time"))
        except RosError as error:
            self._mark_stale(
                Unreachable(f"no ROS 1 master yet: {error}; start roscore, or name another: ros1://HOST:PORT")
            )
        self._tasks.begin(self._watch_system())
        self._tasks.begin(self._watch_parameters())

    async def _first_poll(self) -> None:
        await self._poll()
        await self._removals.wait(_FIRST_PATIENCE)
        await self.parameters.poll()
        self.refresh()
        await self.services.probes.wait(1.0)
        await self.reconfigurables.wait_described(_FIRST_PATIENCE)
        self.refresh()

    async def close(self) -> None:
        """Unregister everything and stop; quick even if the master hangs."""
        self._removals.cancel()
        self._tasks.cancel()
        for reader in self._readers.values():
            reader.close()
        self.actions.close()
        self.reconfigurables.close()
        await self.publications.close()
        self.master.close()

    async def poll(self) -> None:
        """Poll the master now, so that the graph shows our latest changes."""
        try:
            await self._poll()
        except RosError as error:
            self._mark_stale(error)
        self.refresh()

    async def advertise(self, topic: str, type: TypeRef, latch: bool, until: float) -> Publication:
        """Publish a topic, wait for its subscribers, and update the graph."""
        publication = await self.publications.advertise(topic, type, until)
        await self.poll()
        return publication

    async def unadvertise(self, topic: str) -> None:
        """Stop publishing a topic, and update the graph. Raises NotFound."""
        await self.publications.unadvertise(topic)
        await self.poll()

    async def set_parameters(self, values: Mapping[str, ParameterValue], until: float) -> None:
        """Set parameters: those that nodes declare at the nodes, all others at the master. Raises Refused."""
        self.parameters.check(values)
        try:
            accepted = await self.reconfigurables.set(parts_of(values), until)
            self.parameters.note_set(accepted)
            rest = {name: with_parts(name, value, accepted) for name, value in values.items() if name not in accepted}
            await self.parameters.set(rest, until)
        finally:
            self.refresh()

    def poll_soon(self) -> None:
        """Poll the master within a second."""
        self._poll_requested.set()

    def refresh_soon(self) -> None:
        """Rebuild the graph once for all changes in this iteration of the loop."""
        if not self._refreshing:
            self._refreshing = True
            asyncio.get_running_loop().call_soon(self.refresh)

    def refresh(self) -> None:
        """Rebuild the graph and announce changes. A stale graph remains unchanged."""
        self._refreshing = False
        if self._identity is not None:
            run_id = self.parameters.value("/run_id")
            graph = compose(
                self.graph,
                self._system,
                self.facts,
                self.types.unreadable,
                master=Master(self.master.uri, str(run_id) if run_id is not None else None),
                simulated_time=self.parameters.value("/use_sim_time") is True,
                parameters=self.reconfigurables.with_descriptors(self.parameters.graph_parameters),
            )
            self._show(graph)

    def read(self, feed: TopicFeed) -> None:
        """Start reading a topic."""
        reader = TopicReader(feed, self._nodes, self.types, self._epochs.get(feed.topic, 0))
        self._readers[feed.topic] = reader
        publishers = self._system.publishers.get(feed.topic, ())
        reader.follow(publishers)
        if not publishers:
            self.poll_soon()

    def deepen(self, feed: TopicFeed) -> None:
        """Apply a new depth of a topic's feed."""
        if reader := self._readers.get(feed.topic):
            reader.deepen()

    def stop_reading(self, feed: TopicFeed) -> None:
        """Stop reading a topic."""
        reader = self._readers.get(feed.topic)
        if reader is not None and reader.feed is feed:
            del self._readers[feed.topic]
            reader.close()
            self._epochs[feed.topic] = reader.next_epoch

    async def _dial(self) -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
        """Connect to the master, and note our address on the way to it."""
        reader, writer = await self._hosts.streams(*self._address)
        self._local = writer.get_extra_info("sockname")[0]
        return reader, writer

    async def _watch_system(self) -> None:
        while True:
            started = time.monotonic()
            await self.poll()
            for reader in self._readers.values():
                reader.fit_buffers()
            took = time.monotonic() - started
            live = self._snapshot is not None  # an unreachable master has no load: notice its return soon
            pause = min(max(_EVERY, _SHARE * took), _SELDOM) - took if live else _EVERY
            await asyncio.sleep(_SOON)
            await wait_event(self._poll_requested, pause - _SOON)
            self._poll_requested.clear()

    async def _watch_parameters(self) -> None:
        while True:
            await asyncio.sleep(min(max(_EVERY, _SHARE * self.parameters.took), _SELDOM))
            try:
                await self.parameters.poll()
            except RosError:
                pass  # the poll of the system reports the loss of the master
            self._note_identity()

    async def _poll(self) -> None:
        async with self._poll_lock:
            requested_at = asyncio.get_running_loop().time()
            snapshot = await self.master.snapshot()
            if self._snapshot is None or (snapshot.state, snapshot.types) != (
                self._snapshot.state,
                self._snapshot.types,
            ):
                self._system = self.master.system_state(snapshot)
            if self._snapshot is None or snapshot.pid != self._snapshot.pid:
                self._forget_addresses()
            self._snapshot = snapshot
            self._note_identity()
            self._follow(requested_at)

    def _note_identity(self) -> None:
        """Forget the addresses if the master was restarted: as another process, or with another run id."""
        if self._snapshot is None:
            return
        identity = self._snapshot.pid, self.parameters.value("/run_id")
        if self._identity is not None and identity != self._identity:
            self._forget_addresses()
            self.refresh_soon()
        self._identity = identity

    def _forget_addresses(self) -> None:
        self._checked.clear()
        self.services.forget()

    def _follow(self, requested_at: float) -> None:
        """Update everything after a new state of the master."""
        system = self._system
        for topic, reader in self._readers.items():
            reader.follow(system.publishers.get(topic, ()))
        self.actions.update(system)
        self.reconfigurables.follow(system)
        self.services.follow(system.services.items())
        self.publications.register_again(system.publishers, requested_at)
        nodes = system.nodes()
        self.facts.uris.retain(nodes)
        self.facts.unreachable.retain(nodes)
        self.facts.endpoints.retain({(topic, node) for topic, of in system.publishers.items() for node in of})
        self.facts.services.retain(system.services.keys())
        self._note_own(system)
        self._look_up_some(nodes)
        if due := self._leftovers.nodes_to_check(system.publishers):
            self._removals.begin(self._remove_leftovers(due))

    def _note_own(self, system: SystemState) -> None:
        for topic, publication in self.publications.by_topic.items():
            if self._own_node in system.publishers.get(topic, ()):
                facts = EndpointFacts(publication.ref, publication.latched is not None)
                self.facts.endpoints.put((topic, self._own_node), facts)
                self.facts.set_node_uri(self._own_node, self.publications.uri or "")

    def _look_up_some(self, nodes: set[str]) -> None:
        """Look up the addresses of all new nodes, and of a few others again: a restarted node has the same name."""
        self._checked = {node: at for node, at in self._checked.items() if node in nodes}
        new = [node for node in nodes if node not in self._checked]
        oldest = sorted(self._checked, key=self._checked.__getitem__)[:_LOOK_UPS]
        now = time.monotonic()
        chosen = [*new, *(node for node in oldest if now - self._checked[node] > _EVERY)]
        self._checked.update(dict.fromkeys(chosen, now))
        if chosen:
            self._tasks.begin(self._look_up(chosen))

    async def _look_up(self, nodes: Iterable[str]) -> None:
        for node in nodes:
            try:
                await self._nodes.address(node)
            except RosError:
                continue

    async def _remove_leftovers(self, due: Mapping[str, tuple[str, ...]]) -> None:
        """Unregister dead instances of rosld from the master, so that the graph does not show them."""
        removed = await asyncio.gather(*(self._leftovers.remove(node, topics) for node, topics in due.items()))
        if any(removed):
            await self.poll()

    def _mark_stale(self, error: RosError) -> None:
        self._snapshot = None
        self._identity = None
        self._show(self.graph.as_stale(str(error)))

    def _show(self, graph: Graph) -> None:
        if graph is not self.graph:
            self.graph = graph
            self._sink.graph_changed(graph)

    def _parameters_changed(self, names: Sequence[str]) -> None:
        self.refresh_soon()
        for name in names:
            self._sink.parameter_changed(name)
