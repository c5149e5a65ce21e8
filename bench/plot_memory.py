"""Memory of a browser and of the server while ten series at 50 Hz are plotted live, minute by minute.

Run: python bench/plot_memory.py [minutes]. The source is a recording played in a loop. It needs chromium. The figures
of the browser are those of the page after garbage collection: its heap in MB, and the number of its nodes.
"""

from __future__ import annotations

import math
import sys
import tempfile
import time
from pathlib import Path
from urllib.parse import quote

from events import serving, spent
from history import resident
from rosbags.rosbag1 import Writer
from rosbags.typesys import Stores, get_typestore

sys.path.insert(0, str(Path(__file__).parents[1]))

from tests.server.html.devtools import Tab, browser

SERIES, HERTZ, SECONDS = 10, 50, 20
MINUTE = 60.0


def write_recording(path: Path) -> None:
    """Write twenty seconds of ten topics, each a different wave."""
    types = get_typestore(Stores.ROS1_NOETIC)
    value = types.types["std_msgs/msg/Float64"]
    with Writer(path) as bag:
        topics = [
            bag.add_connection(f"/wave{number}", value.__msgtype__, typestore=types, callerid="/waves")
            for number in range(SERIES)
        ]
        for step in range(HERTZ * SECONDS):
            at = 1_700_000_000_000_000_000 + step * 1_000_000_000 // HERTZ
            for number, topic in enumerate(topics):
                height = math.sin((number + 1) * step * math.tau / (HERTZ * SECONDS))
                bag.write(topic, at, types.serialize_ros1(value(data=height), value.__msgtype__))


def heap(tab: Tab) -> tuple[float, int, float]:
    """Return the heap of a page after garbage collection in MB, its nodes, and the CPU seconds of its thread."""
    tab.send("HeapProfiler.collectGarbage")
    found = {each["name"]: each["value"] for each in tab.send("Performance.getMetrics")["metrics"]}
    return found["JSHeapUsedSize"] / 1e6, int(found["Nodes"]), found["TaskDuration"]


def watch(minutes: int, folder: Path) -> None:
    """Plot for some minutes, and print the memory after each."""
    write_recording(folder / "waves.bag")
    command = ("-m", "rosld", "serve", str(folder / "waves.bag"), "--port", "0")
    with serving(*command) as (url, process), browser(folder / "browser") as window, window.tab() as tab:
        tab.send("Performance.enable")
        shown = "&".join(f"y={quote(f'topics/wave{number}#data', safe='')}" for number in range(SERIES))
        tab.open(f"{url}plot?{shown}")
        tab.until("Number(document.querySelector('figure[data-points]')?.dataset.points) > 100")
        for minute in range(minutes + 1):
            if minute:
                time.sleep(MINUTE)
            used, nodes, busy = heap(tab)
            points = tab.run("Number(document.querySelector('figure[data-points]').dataset.points)")
            print(
                f"{minute:3} min: page {used:5.1f} MB, {nodes} nodes, {points} points, {busy:.1f} s at work; "
                f"server {resident(process):5.1f} MB, {spent(process):.1f} s at work",
                flush=True,
            )
        print(f"faults: {tab.faults or 'none'}")


def main() -> None:
    """Print memory by minutes."""
    minutes = int(sys.argv[1]) if len(sys.argv) > 1 else 10
    with tempfile.TemporaryDirectory() as name:
        watch(minutes, Path(name))


if __name__ == "__main__":
    main()
