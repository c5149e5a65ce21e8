"""An aircraft behind the Foxglove server of another rosld as a robot of the contract suite."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from rosld.adapters.base import AdapterOptions
from rosld.adapters.foxglove import adapter
from tests.adapters.ros1.system import free_port
from tests.contracts.robot import Asked, Robot, Spoken
from tests.serving_thread import ServingThread

SET_SPEED = "/aircraft/engine/set_speed"
HAS = frozenset(["nowhere", "writable", "answering", "raising", "vanish", "come_back"])


class Peer:
    """The other server, always at the same port."""

    def __init__(self) -> None:
        self.port = free_port()
        self._running: ServingThread | None = None

    def start(self) -> None:
        """Serve an aircraft."""
        self._running = ServingThread.of_command("aircraft", "--port", str(self.port))
        self._running.url()

    def stop(self) -> None:
        """End the server."""
        if self._running is not None:
            running, self._running = self._running, None
            running.send_signal(signal.SIGTERM)
            running.wait(60)


@contextmanager
def robot(folder: Path) -> Iterator[object]:
    """Run the system."""
    peer = Peer()
    peer.start()
    try:
        yield Robot(
            name="foxglove",
            adapter=lambda: adapter(f"foxglove://127.0.0.1:{peer.port}/foxglove", AdapterOptions()),
            nowhere=lambda: adapter(f"foxglove://127.0.0.1:{free_port()}", AdapterOptions()),
            readable="/aircraft/engine/speed",
            writable=Spoken("/cockpit/display", "std_msgs/msg/String", {"data": "cleared for take-off"}),
            answering=Asked("/aircraft/get_power", "rosld_aircraft/srv/GetText", {}, response={"data": "off"}),
            raising=Asked(SET_SPEED, "rosld_aircraft/srv/SetSpeed", {"data": 5000.0}, words="at most 1000"),
            vanish=peer.stop,
            come_back=peer.start,
        )
    finally:
        peer.stop()
