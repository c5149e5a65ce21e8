"""Notification channels (Solid Notifications Protocol 2.3), which exist as long as their clients use them."""

from __future__ import annotations

import asyncio
import contextlib
import secrets
import time
from collections.abc import Callable, Iterator
from functools import lru_cache

from msgspec import Struct
from msgspec.structs import replace
from pyoxigraph import NamedNode

from rosld.ontology.notifications import Activity, ChannelDescription
from rosld.ontology.vocab import ldp
from rosld.server.auth.authenticator import UNRESTRICTED, AuthContext
from rosld.server.auth.permissions import Permissions
from rosld.server.events import query_params
from rosld.server.events.broadcaster import Observation
from rosld.server.events.channel_request import ChannelRequest
from rosld.server.http.problem import Problem
from rosld.server.receipts.audit import record_step
from rosld.server.rest.resource import Resource
from rosld.server.rest.state import State
from rosld.server.runtime.dry_run import end_dry_run

MAX_CHANNELS = 4000
"""Maximum number of channels; a new one replaces the one without a receiver for the longest time."""
IDLE_SECONDS = 300.0
"""Seconds that a channel without a receiver exists: the time for a client to connect, or to reconnect."""
NO_CHANNEL = "There is no such channel, or it has expired: subscribe again."
"""The same words for every path, so that they do not tell which robots exist."""
_SECOND = 1_000_000_000


class ReceiverState(Struct, frozen=True):
    """Knowledge of a channel's receiver: the name of the topic's state, None if the topic did not exist.

    `container` is that state, during reception, if it lists members: to report which one was added or removed.
    """

    name: str | None
    container: State | None = None


class Channel(Struct, eq=False):
    """A channel: its description, the observed resource, the last reported state, and its receiver."""

    token: str
    terms: ChannelDescription
    resource: Resource
    last_sent: ReceiverState
    since: float
    """Start of the time without a receiver (monotonic, s)."""
    receiver: asyncio.Task[None] | None = None
    auth: AuthContext = UNRESTRICTED
    """Permissions of the creator, who may lose the right to read."""
    due: float = float("-inf")
    """Earliest time (monotonic, s) of the next notification."""

    @property
    def is_over(self) -> bool:
        """Whether the channel has expired."""
        if self.terms.end_at is not None and time.time_ns() >= self.terms.end_at:
            return True
        return self.receiver is None and time.monotonic() - self.since >= IDLE_SECONDS

    @property
    def seconds_left(self) -> float | None:
        """Seconds until the end of the channel, None without one."""
        end = self.terms.end_at
        return None if end is None else max(0.0, (end - time.time_ns()) / _SECOND)

    @property
    def seconds_to_start(self) -> float:
        """Seconds until the start of the channel."""
        start = self.terms.start_at
        return 0.0 if start is None else max(0.0, (start - time.time_ns()) / _SECOND)


class Channels:
    """Channels of one server. `instance_id` identifies this run of the server in the names of states."""

    def __init__(self, instance_id: str, limit: int = MAX_CHANNELS) -> None:
        self._instance_id = instance_id
        self._limit = limit
        self._channels: dict[str, Channel] = {}

    def __len__(self) -> int:
        return len(self._channels)

    def open(
        self,
        wish: ChannelRequest,
        type: str,
        resource: Resource,
        state: State,
        place: Callable[[str], tuple[str, str]],
        auth: AuthContext = UNRESTRICTED,
    ) -> Channel:
        """Create a channel; `place` returns the URLs of a channel and of its source by its token.

        If the topic's state differs from the one that the client says it has, the first notification is due at once.
        Raises a 503 Problem if there are too many channels.
        """
        record_step(f"open a notification channel for {resource.url}")
        self._make_room()
        end_dry_run()
        token = secrets.token_urlsafe(24)
        url, source = place(token)
        times = (wish.interval, wish.start_at, wish.end_at)
        terms = ChannelDescription(url, type, resource.url, source, wish.accept, *times, wish.state)
        known = wish.state if wish.state is not None else self.state_name(state)
        channel = Channel(token, terms, resource, ReceiverState(known), time.monotonic(), auth=auth)
        self._channels[token] = channel
        return channel

    def find(self, token: str) -> Channel:
        """Return the channel with a token. Raises a 404 Problem if there is none, or it has expired."""
        channel = self._channels.get(token)
        if channel is None or channel.is_over or not channel.auth.is_valid():
            self._channels.pop(token, None)
            raise Problem(404, NO_CHANNEL)
        return channel

    def topic_of(self, token: str) -> str | None:
        """Return the URL of a channel's topic, None for an unknown channel (thread-safe)."""
        channel = self._channels.get(token)
        return None if channel is None else channel.terms.topic

    def close(self, channel: Channel) -> None:
        """End a channel, and the task that sends to its receiver unless that is the current task."""
        end_dry_run()
        self._channels.pop(channel.token, None)
        if channel.receiver is not None and channel.receiver is not asyncio.current_task():
            channel.receiver.cancel()

    def has(self, channel: Channel) -> bool:
        """Whether the channel still exists."""
        return self._channels.get(channel.token) is channel

    @contextlib.contextmanager
    def attach_receiver(self, channel: Channel) -> Iterator[None]:
        """Make the current task the channel's receiver; the previous one, usually of the same client, is cancelled."""
        task = asyncio.current_task()
        if channel.receiver is not None:
            channel.receiver.cancel()
        channel.receiver = task
        try:
            yield
        finally:
            if channel.receiver is task:
                channel.receiver = None
                channel.since = time.monotonic()
                channel.last_sent = replace(channel.last_sent, container=None)

    def state_name(self, state: State) -> str:
        """Return the name of a state: the state part of the entity tags of its representations."""
        return f"{state.scope or self._instance_id}-{state.tag}"

    def next_notification(self, channel: Channel, observation: Observation) -> tuple[Activity | None, ReceiverState]:
        """Return the notification of an observation, None if nothing is new, and the new state of the receiver.

        A state that cannot be read (the robot does not answer) is not reported until it can be read again.
        """
        last_sent, topic = channel.last_sent, channel.terms.topic
        if isinstance(observation.state, Problem):
            if not _is_absent(observation.state) or last_sent.name is None:
                return None, last_sent
            return Activity("Delete", topic), ReceiverState(None)
        name = self.state_name(observation.state)
        now = ReceiverState(name, observation.state if _reports_members(channel.resource, observation.state) else None)
        if last_sent.name is None:
            return Activity("Create", topic, state=name), now
        if query_params.is_state(last_sent.name, name):
            return None, now
        return _activity_of_change(topic, last_sent.container, now, channel.auth.permissions), now

    def _make_room(self) -> None:
        if len(self._channels) < self._limit:
            return
        over = [one for one in self._channels.values() if one.is_over]
        waiting = [one for one in self._channels.values() if one.receiver is None]
        if not over and not waiting:
            words = f"{self._limit} channels already have receivers. Try again later."
            raise Problem(503, words, headers={"Retry-After": "60"})
        end_dry_run()
        for channel in over or [min(waiting, key=lambda one: one.since)]:
            self.close(channel)


def _is_absent(problem: Problem) -> bool:
    """Whether the problem means that the topic is not there: deleted or moved."""
    return problem.status in (404, 410) or problem.status < 400


def _activity_of_change(topic: str, before: State | None, now: ReceiverState, permissions: Permissions) -> Activity:
    """Return which member was added or removed if the agent may know of it, else an update of the topic."""
    if before is not None and now.container is not None:
        old, new = _members(before), _members(now.container)
        if len(old ^ new) == 1:
            (member,) = old ^ new
            if not permissions.may_read(member):
                return Activity("Update", topic, state=now.name)
            return Activity("Add" if member in new else "Remove", member, topic, now.name)
    return Activity("Update", topic, state=now.name)


def _reports_members(resource: Resource, state: State) -> bool:
    """Whether a state lists members. The state of a complex resource has values as well, and a view."""
    return state.view is None and any(link.target.endswith("Container") for link in resource.links)


@lru_cache(maxsize=8)
def _members(state: State) -> frozenset[str]:
    """Return the URLs of members in the state of a container, found once per state."""
    found = [triple.object for triple in state.document.triples if triple.predicate == ldp.contains]
    return frozenset(one.value for one in found if isinstance(one, NamedNode))
