"""Execution of nodes in one process until SIGINT ends them in an orderly way; for the scripts next to this file."""

from __future__ import annotations

import signal
import threading
from collections.abc import Sequence

from rclpy.context import Context
from rclpy.executors import Executor, ExternalShutdownException
from rclpy.node import Node

ENDING = threading.Event()
"""Set by SIGINT."""


def say(text: str) -> None:
    print(f"{text}\n", end="", flush=True)


def begun(*waited_for: threading.Event) -> Context:
    """Return a context for nodes. From now on SIGINT sets `ENDING` and these events, which nodes wait for."""
    context = Context()
    context.init(args=[])
    signal.signal(signal.SIGINT, lambda *_: [event.set() for event in (ENDING, *waited_for)])
    return context


def run(context: Context, executor: Executor, nodes: Sequence[Node]) -> None:
    """Run nodes until `ENDING`; prints "ready" when they run."""
    for node in nodes:
        executor.add_node(node)

    def spin() -> None:
        try:
            executor.spin()
        except ExternalShutdownException:
            return

    spinning = threading.Thread(target=spin, daemon=True)
    spinning.start()
    say("ready")
    ENDING.wait()
    executor.shutdown(1.0)
    context.try_shutdown()
    spinning.join(1.0)
