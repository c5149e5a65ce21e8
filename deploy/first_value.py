"""Measure the seconds from the start of a command to the first value of its aircraft.

    python deploy/first_value.py [--url URL] COMMAND...

The command serves the aircraft and prints its URL, as `rosld serve aircraft --port 0` does. With `--url` it need not
print it; with `--url` alone, the server is already running.
"""

from __future__ import annotations

import subprocess
import sys
import time
import urllib.error
import urllib.request
from collections.abc import Mapping, Sequence

VALUE = "topics/aircraft/engine/speed"
PATIENCE = 600.0


def first_value(command: Sequence[str], url: str | None = None, env: Mapping[str, str] | None = None) -> float:
    """Run the command until it serves a value, end it by SIGTERM, and return the seconds. Raises RuntimeError."""
    begin = time.monotonic()
    if not command and url is not None:
        return _wait(url, begin)
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=env) as process:
        assert process.stdout is not None
        try:
            base = url or next((line.strip() for line in process.stdout if line.startswith("http")), None)
            if base is None:
                raise RuntimeError(f"{command[0]} ended with {process.wait()} before it printed a URL")
            seconds = _wait(base, begin)
        finally:
            process.terminate()
            process.wait(30)
    return seconds


def _wait(base: str, begin: float) -> float:
    request = urllib.request.Request(base + VALUE, headers={"Accept": "application/json"})
    while True:
        try:
            with urllib.request.urlopen(request, timeout=10) as response:
                if b'"data"' in response.read():
                    return time.monotonic() - begin
        except (urllib.error.URLError, OSError):
            if time.monotonic() - begin > PATIENCE:
                raise
        time.sleep(0.05)


if __name__ == "__main__":
    arguments = sys.argv[1:]
    known = arguments.pop(1) if arguments[:1] == ["--url"] else None
    print(f"{first_value(arguments[1:] if known else arguments, known):.1f} s")
