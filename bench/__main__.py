"""`make bench`: all benchmarks in sequence, each as a ratio to its baseline in the same run."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

PARTS = (
    "lifting.py",
    "conversion.py",
    "web.py",
    "ros1_ingest.py",
    "ros2.py",
    "sparql.py",
    "gsp.py",
    "events.py",
    "ldp.py",
    "update.py",
    "changes.py",
    "rights.py",
    "holds.py",
    "stop.py",
    "kills.py",
    "history.py",
    "history_kills.py",
    "past.py",
    "pauses.py",
    "clients.py",
    "pictures.py",
    "tools.py",
)


def main() -> int:
    """Run the benchmarks; return the number of those that failed."""
    failed = 0
    for part in PARTS:
        path = Path(__file__).with_name(part)
        print(f"\n== {part}", flush=True)
        failed += subprocess.run([sys.executable, str(path)], check=False).returncode != 0
    return failed


if __name__ == "__main__":
    sys.exit(main())
