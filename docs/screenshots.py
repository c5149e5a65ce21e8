"""Photographs the rover for the README: `python -m docs.screenshots` writes the pictures to `docs/images`.

It serves the rover on a free port, sends it to the other room, and photographs pages while it drives. Needs chromium
and the fonts in tests/debian-browser.txt.
"""

from __future__ import annotations

import io
import json
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple
from urllib.parse import quote
from urllib.request import Request, urlopen

from PIL import Image

from tests.server.html.devtools import browser

IMAGES = Path(__file__).parent / "images"
QUERY = """SELECT ?sensor ?property ?value ?unit WHERE {
  ?observation sosa:madeBySensor ?sensor ;
    sosa:observedProperty ?property ;
    sosa:hasResult ?result .
  ?result qudt:numericValue ?value ; qudt:hasUnit ?unit .
}
ORDER BY ?property"""


class Picture(NamedTuple):
    """A page, the size of the window, where the rover is sent, and when the page is complete."""

    path: str
    size: tuple[int, int]
    goal: tuple[float, float] | None
    complete: str


PICTURES = {
    "cockpit.png": Picture(
        "cockpit/default",
        (1440, 1244),
        (4, -1),
        "Number(document.querySelector('.panel.plot figure').dataset.points) > 110"
        " && document.querySelector('.panel img').dataset.moving === 'yes'"
        " && Number(document.querySelector('.panel.space canvas').dataset.messages) > 100",
    ),
    "topic.png": Picture(
        "topics/odom",
        (1100, 1168),
        (-3, 0),
        "Number(document.querySelector('.space canvas').dataset.messages) > 150",
    ),
    "sparql.png": Picture(
        f"sparql?query={quote(QUERY, safe='')}#table", (1100, 990), None, "!!document.querySelector('.yasr table')"
    ),
}


@contextmanager
def rover() -> Iterator[str]:
    """Serve the rover; yield the URL of the server."""
    command = [sys.executable, "-m", "rosld", "serve", "rover:?pose=-3.6,-0.5,0", "--port", "0"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as server:
        try:
            assert server.stdout is not None
            url = server.stdout.readline().strip()
            if not url:
                raise SystemExit("rosld serve rover has not started; its reason stands above")
            yield url
        finally:
            server.terminate()


def send(base: str, x: float, y: float) -> None:
    """Send the rover to a position."""
    goal = json.dumps({"pose": {"pose": {"position": {"x": x, "y": y}}}}).encode()
    urlopen(Request(f"{base}actions/navigate_to", goal, {"Content-Type": "application/json"}), timeout=30).close()


def main() -> None:
    with tempfile.TemporaryDirectory() as folder, rover() as base, browser(Path(folder) / "profile") as window:
        for name, (path, (width, height), goal, complete) in PICTURES.items():
            with window.tab() as tab:
                size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False}
                tab.send("Emulation.setDeviceMetricsOverride", **size)
                tab.open(base + path)
                if goal is not None:
                    send(base, *goal)
                tab.until(complete)
                tab.photograph(picture := Path(folder) / name, width, height)
            image = Image.open(io.BytesIO(picture.read_bytes())).convert("RGB").quantize(256, dither=Image.Dither.NONE)
            image.save(IMAGES / name, optimize=True)
            print(IMAGES / name, (IMAGES / name).stat().st_size)


if __name__ == "__main__":
    main()
