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
from urllib.parse import quote
from urllib.request import Request, urlopen

from PIL import Image

from tests.server.html.devtools import browser

IMAGES = Path(__file__).parent / "images"
GOAL = {"pose": {"pose": {"position": {"x": 4, "y": -3}}}}
QUERY = """SELECT ?sensor ?property ?value ?unit WHERE {
  ?observation sosa:madeBySensor ?sensor ;
    sosa:observedProperty ?property ;
    sosa:hasResult ?result .
  ?result qudt:numericValue ?value ; qudt:hasUnit ?unit .
}
ORDER BY ?property"""
PICTURES = {
    "cockpit.png": (
        "cockpit/default",
        (1280, 960),
        "Number(document.querySelector('.panel.plot figure').dataset.points) > 250"
        " && document.querySelector('.panel img').dataset.moving === 'yes'"
        " && Number(document.querySelector('.panel.space canvas').dataset.messages) > 100",
    ),
    "topic.png": ("topics/odom", (1100, 760), "true"),
    "sparql.png": (f"sparql?query={quote(QUERY, safe='')}#table", (1100, 860), "document.querySelector('.yasr table')"),
}
"""Pages, with the size of the window and when they are complete."""


@contextmanager
def rover() -> Iterator[str]:
    """Serve the rover on its way to a goal; yield the URL of the server."""
    command = [sys.executable, "-m", "rosld", "serve", "rover:?pose=-3.5,-2,0", "--port", "0"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as server:
        try:
            assert server.stdout is not None
            url = server.stdout.readline().strip()
            if not url:
                raise SystemExit("rosld serve rover has not started; its reason stands above")
            fields = {"Content-Type": "application/json"}
            goal = Request(f"{url}actions/navigate_to", json.dumps(GOAL).encode(), fields)
            urlopen(goal, timeout=30).close()
            yield url
        finally:
            server.terminate()


def main() -> None:
    with tempfile.TemporaryDirectory() as folder, rover() as base, browser(Path(folder) / "profile") as window:
        for name, (path, (width, height), complete) in PICTURES.items():
            with window.tab() as tab:
                size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False}
                tab.send("Emulation.setDeviceMetricsOverride", **size)
                tab.open(base + path)
                tab.until(complete)
                tab.photograph(picture := Path(folder) / name, width, height)
            image = Image.open(io.BytesIO(picture.read_bytes())).convert("RGB").quantize(256, dither=Image.Dither.NONE)
            image.save(IMAGES / name, optimize=True)
            print(IMAGES / name, (IMAGES / name).stat().st_size)


if __name__ == "__main__":
    main()
