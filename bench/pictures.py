"""A camera in motion: 640 by 480 pixels raw at 25 Hz as JPEG, to no viewer, to one and to ten.

Run: python bench/pictures.py [seconds]. The source is a recording that is played in a loop. The table has the CPU time
of the server per second, and the pictures that each viewer received; the ratio is that of ten viewers to one.
"""

from __future__ import annotations

import asyncio
import statistics
import sys
import tempfile
import time
from pathlib import Path
from typing import cast
from urllib.parse import urlsplit

import numpy as np
from events import serving, spent
from rosbags.rosbag1 import Writer
from rosbags.typesys import Stores, get_typestore

WIDTH, HEIGHT, HERTZ = 640, 480, 25
FRAMES = 50
ROUNDS = 3
_PICTURE = b"Content-Type: image/jpeg"


def write_recording(path: Path) -> None:
    """Write two seconds of a camera that pans over a scene with some noise."""
    types = get_typestore(Stores.ROS1_NOETIC)
    image, header, stamp = (
        types.types[name] for name in ("sensor_msgs/msg/Image", "std_msgs/msg/Header", "builtin_interfaces/msg/Time")
    )
    generator = np.random.default_rng(1)
    row, column = np.mgrid[0:HEIGHT, 0 : WIDTH + FRAMES]
    scene = np.stack([column / 3, row / 2, 80 * np.sin(column / 23) * np.cos(row / 17) + 120], axis=-1)
    scene += generator.normal(0, 4, scene.shape)
    pixels = np.clip(scene, 0, 255).astype(np.uint8)
    with Writer(path) as bag:
        camera = bag.add_connection("/camera", image.__msgtype__, typestore=types, callerid="/camera_node")
        for number in range(FRAMES):
            when = header(seq=number, stamp=stamp(sec=0, nanosec=0), frame_id="camera")
            data = np.ascontiguousarray(pixels[:, number : number + WIDTH]).ravel()
            message = image(when, HEIGHT, WIDTH, "bgr8", 0, WIDTH * 3, data)
            at = 1_700_000_000_000_000_000 + number * 1_000_000_000 // HERTZ
            bag.write(camera, at, types.serialize_ros1(message, image.__msgtype__))


class Viewer(asyncio.Protocol):
    """A viewer of the motion stream, which counts its pictures."""

    def __init__(self, host: str) -> None:
        self.pictures = 0
        self._head = f"GET /topics/camera?format=mjpeg&rate=100 HTTP/1.1\r\nHost: {host}\r\n\r\n".encode()

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        cast(asyncio.Transport, transport).write(self._head)

    def data_received(self, data: bytes) -> None:
        self.pictures += data.count(_PICTURE)


async def measure(url: str, process: int, viewers: int, seconds: float) -> tuple[float, float]:
    """Return CPU seconds and the pictures of each viewer, per second."""
    parts, loop = urlsplit(url), asyncio.get_running_loop()
    made = [
        await loop.create_connection(lambda: Viewer(parts.netloc), parts.hostname, parts.port) for _ in range(viewers)
    ]
    await asyncio.sleep(2)
    seen = [viewer.pictures for _, viewer in made]
    before, began = spent(process), time.monotonic()
    await asyncio.sleep(seconds)
    took, used = time.monotonic() - began, spent(process) - before
    got = [viewer.pictures - earlier for (_, viewer), earlier in zip(made, seen, strict=True)]
    for transport, _ in made:
        transport.close()
    return used / took, statistics.mean(got) / took if got else 0.0


def main() -> None:
    """Print the table."""
    seconds = float(sys.argv[1]) if len(sys.argv) > 1 else 8.0
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "camera.bag"
        write_recording(path)
        with serving("-m", "rosld", "serve", str(path), "--subscribe", "/camera", "--port", "0") as (url, process):
            found = {count: [] for count in (0, 1, 10)}  # type: dict[int, list[tuple[float, float]]]
            for _ in range(ROUNDS):
                for count, rows in found.items():
                    rows.append(asyncio.run(measure(url, process, count, seconds)))
    print(f"{WIDTH}x{HEIGHT} raw at {HERTZ} Hz, JPEG")
    print(f"{'viewers':>8}{'cores':>8}{'Hz each':>9}")
    for count, rows in found.items():
        cores, hertz = (statistics.median(column) for column in zip(*rows, strict=True))
        print(f"{count:8}{cores:8.3f}{hertz:9.1f}")
    ratio = statistics.median(ten[0] / one[0] for ten, one in zip(found[10], found[1], strict=True))
    print(f"ratio {ratio:.2f}")


if __name__ == "__main__":
    main()
