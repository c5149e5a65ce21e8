"""A server killed a hundred times while it records: the loss of each kill, and whether other readers read every file.

The rover sends more than twenty messages per second: the newest that can be read afterwards shows how much was lost.

Run: python bench/history_kills.py [times]. Target: never more than two seconds lost, never an unreadable file.
"""

from __future__ import annotations

import random
import statistics
import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

from tests.server.disks.server import server_on
from tests.server.history.mcap_files import finished, read

TIMES = 100
BOUND = 2.0


def main() -> int:
    """Print the losses; return 1 if one is too large or a file is unreadable."""
    times = int(sys.argv[1]) if len(sys.argv) > 1 else TIMES
    lost: list[float] = []
    with (
        tempfile.TemporaryDirectory() as name,
        server_on(Path(name) / "data", Path(name) / "log", source="rover") as server,
    ):
        folder = Path(name) / "data" / "history"
        server.start("--history", "*")
        for _ in range(times):
            began = time.time()
            time.sleep(random.uniform(0.5, 4.0))
            killed = time.time()
            server.kill()
            server.start("--history", "*")
            newest = max([one.time_ns for path in finished(folder)[-2:] for one in read(path)], default=0)
            lost.append(killed - max(newest / 1e9, began))
        server.stop()
        files = sorted(folder.glob("*.mcap"))
        sequences = [one.sequence for path in files for one in read(path)]
    is_once = len(set(sequences)) == len(sequences)
    print(f"{times} kills: {statistics.median(lost):.2f} s lost, {max(lost):.2f} s at most; {len(files)} files read")
    print(f"{len(sequences)} messages, every number once: {is_once}")
    return int(max(lost) > BOUND or not is_once)


if __name__ == "__main__":
    sys.exit(main())
