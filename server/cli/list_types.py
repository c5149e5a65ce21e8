"""`rosld types`: the message, service and action types that a source uses."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from contextlib import contextmanager

import click

from rosld.adapters.base import Adapter, AdapterOptions, NullSink, Sink
from rosld.adapters.model import Graph, Stale, TypeRef, Unreachable
from rosld.adapters.registry import adapter_for
from rosld.server.cli.failure import ExitCode, user_errors
from rosld.server.cli.tables import json_text

OPEN_SECONDS = 5.0


async def open_at_once(adapter: Adapter, sink: Sink) -> None:
    """Open an adapter for a command that does not wait for an unreachable robot.

    Raises Unreachable for one, and what `Adapter.open` raises.
    """
    await adapter.open(sink, deadline=asyncio.get_running_loop().time() + OPEN_SECONDS)
    state = adapter.graph.state
    if isinstance(state, Stale):
        await adapter.close()
        raise Unreachable(state.why)


@contextmanager
def open_source(source: str, options: AdapterOptions) -> Iterator[Adapter]:
    """Open the adapter of a source, and close it at the end. Raises ValueError and the adapter's errors.

    Its loop is stopped in between, so that Ctrl-C ends the work at once.
    """
    adapter = adapter_for(source, options)
    loop = asyncio.new_event_loop()
    try:
        loop.run_until_complete(open_at_once(adapter, NullSink()))
        loop.run_until_complete(adapter.wait_for_recordings())
        yield adapter
    finally:
        loop.run_until_complete(adapter.close())
        loop.close()


def types_in_use(graph: Graph) -> set[TypeRef]:
    """Return the types of topics, services and actions in the graph."""
    topics = {ref for topic in graph.topics.values() for ref in topic.types}
    services = {service.type for service in graph.services.values() if service.type is not None}
    return topics | services | {action.type for action in graph.actions.values() if action.type is not None}


def types(source: str, options: AdapterOptions, *, as_json: bool = False) -> None:
    """Print one line per type: its name and, after a tab, its hash if known; or all as JSON."""
    with user_errors(ExitCode.USAGE), open_source(source, options) as adapter:
        found = types_in_use(adapter.graph) | set(adapter.known_types())
    hashed = {ref.name for ref in found if ref.hash is not None}
    listed = [ref for ref in found if ref.hash is not None or ref.name not in hashed]
    listed.sort(key=lambda ref: (ref.name, ref.hash or ""))
    if as_json:
        click.echo(json_text([{"name": ref.name, "hash": ref.hash} for ref in listed]))
        return
    for ref in listed:
        click.echo(ref.name if ref.hash is None else f"{ref.name}\t{ref.hash}")
