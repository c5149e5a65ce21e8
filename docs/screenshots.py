"""Photographs the demo for the README: `python docs/screenshots.py` writes the pictures to `docs/images`.

It starts `rosld serve aircraft` on a free port, waits for the URL on its standard output, starts the aircraft, and ends
it all again. Needs chromium and the fonts in tests/debian-browser.txt.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from urllib.parse import quote
from urllib.request import Request, urlopen

IMAGES = Path(__file__).parent / "images"
QUERY = """PREFIX ros: <https://w3id.org/rosld#>

SELECT ?node ?topic ?type ?rate WHERE {
  ?node ros:publishes ?topic .
  ?topic ros:hasMessageType ?type ;
         ros:rate ?rate .
}
ORDER BY ?topic"""
PICTURES = {
    "entry.png": ("", (1100, 940)),
    "resource.png": ("resources/aircraft/", (1100, 760)),
    "topic.png": ("topics/aircraft/engine/speed", (1100, 760)),
    "sparql.png": (f"sparql?query={quote(QUERY, safe='')}&format=html", (1100, 860)),
}


@contextmanager
def aircraft() -> Iterator[str]:
    """The demo, served; yields its entry URL."""
    command = [sys.executable, "-m", "rosld", "serve", "aircraft", "--port", "0"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as server:
        try:
            assert server.stdout is not None
            url = server.stdout.readline().strip()
            if not url:
                raise SystemExit("rosld serve aircraft has not started; its reason stands above")
            yield url
        finally:
            server.terminate()


def photograph(url: str, target: Path, size: tuple[int, int]) -> None:
    """One page as a PNG file."""
    program = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if program is None:
        raise SystemExit("chromium is not installed: apt-get install $(cat tests/debian-browser.txt)")
    quiet = "--headless --no-sandbox --disable-gpu --no-first-run --disable-background-networking --hide-scrollbars"
    with tempfile.TemporaryDirectory() as profile:
        arguments = ["--disable-component-update", "--disable-sync", f"--user-data-dir={profile}"]
        picture = [f"--window-size={size[0]},{size[1]}", f"--screenshot={target}"]
        subprocess.run(
            [program, *quiet.split(), *arguments, *picture, url], check=True, capture_output=True, timeout=120
        )


def main() -> None:
    with aircraft() as base:
        urlopen(Request(f"{base}resources/aircraft/start", method="POST"), timeout=30).close()
        for name, (path, size) in PICTURES.items():
            urlopen(base + path, timeout=30).close()  # the first look subscribes, so the second has a value
            photograph(base + path, IMAGES / name, size)
            print(IMAGES / name)


if __name__ == "__main__":
    main()
