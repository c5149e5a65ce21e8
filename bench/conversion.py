"""Conversion of one large recording of IMUs: two workers compared to one, tables, and workers that are killed.

Run: python bench/conversion.py [megabytes [kills]]. On two free cores, two workers should be at least 1.8 times as
fast as one, and a gigabyte should be Parquet within 60 s. Kills should change no byte.
"""

from __future__ import annotations

import multiprocessing
import random
import sys
import tempfile
import threading
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

import numpy as np
from mcap.writer import CompressionType, Writer
from rosbags.typesys import Stores, get_typestore

from rosld.server.cli.conversion_commands import export, lift

STAMP, ORIENTATION = slice(4, 12), slice(28, 60)
RATE, START_NS = 800, 1_700_000_000_000_000_000


def write(path: Path, megabytes: int) -> None:
    """Write an MCAP of four IMUs at 200 Hz."""
    store = get_typestore(Stores.ROS2_JAZZY)
    kinds = store.types
    vector = kinds["geometry_msgs/msg/Vector3"](x=0.1, y=0.2, z=9.81)
    imu = kinds["sensor_msgs/msg/Imu"](
        header=kinds["std_msgs/msg/Header"](
            stamp=kinds["builtin_interfaces/msg/Time"](sec=0, nanosec=0), frame_id="imu_link"
        ),
        orientation=kinds["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=0.0, w=1.0),
        orientation_covariance=np.zeros(9),
        angular_velocity=vector,
        angular_velocity_covariance=np.zeros(9),
        linear_acceleration=vector,
        linear_acceleration_covariance=np.zeros(9),
    )
    data = bytearray(store.serialize_cdr(imu, "sensor_msgs/msg/Imu"))
    values = np.random.default_rng(0).random((1000, 4))
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=1 << 20, compression=CompressionType.NONE)
        writer.start("ros2", "bench")
        definition = store.generate_msgdef("sensor_msgs/msg/Imu", ros_version=2)[0].encode()
        schema = writer.register_schema("sensor_msgs/msg/Imu", "ros2msg", definition)
        channels = [writer.register_channel(f"/imu{number}", "cdr", schema) for number in range(4)]
        for number in range(megabytes * 1_000_000 // len(data)):
            at = START_NS + number * 1_000_000_000 // RATE
            data[STAMP] = np.array([at // 1_000_000_000, at % 1_000_000_000], "<u4").tobytes()
            data[ORIENTATION] = values[number % 1000].tobytes()
            writer.add_message(channels[number % 4], at, bytes(data), at, number)
        writer.finish()


def seconds(command: object, *arguments: str | Path) -> float:
    """Run a command, and return the seconds it took."""
    began = time.perf_counter()
    command.main([*map(str, arguments)], standalone_mode=False)  # type: ignore[attr-defined]
    return time.perf_counter() - began


def kill_workers(kills: int, is_over: threading.Event) -> None:
    """Kill a random worker every half second."""
    dice = random.Random(1)
    while kills and not is_over.wait(0.5):
        if workers := multiprocessing.active_children():
            dice.choice(workers).kill()
            kills -= 1


def main() -> None:
    megabytes, kills = (int(each) for each in (*sys.argv[1:], *("200", "20")[len(sys.argv) - 1 :]))
    with tempfile.TemporaryDirectory() as folder:
        run, one, two, other = (Path(folder, name) for name in ("run.mcap", "one.nq.gz", "two.nq.gz", "other.nq.gz"))
        write(run, megabytes)
        size = run.stat().st_size / 1e9
        alone = seconds(lift, run, "-o", one, "--workers", "1")
        both = seconds(lift, run, "-o", two, "--workers", "2")
        assert one.read_bytes() == two.read_bytes()
        print(
            f"lifting {size:.2f} GB: {alone:.1f} s by one worker, {both:.1f} s by two, {alone / both:.2f} times as fast"
        )
        took = seconds(export, run, "-o", Path(folder, "tables"), "--workers", "2")
        print(f"Parquet by two workers: {took:.1f} s, {took / size:.0f} s a gigabyte (60 at most)")
        is_over = threading.Event()
        killer = threading.Thread(target=kill_workers, args=(kills, is_over))
        killer.start()
        took = seconds(lift, run, "-o", other, "--workers", "2")
        is_over.set()
        killer.join()
        assert one.read_bytes() == other.read_bytes()
        print(f"lifting with up to {kills} workers killed, two a second: {took:.1f} s, the same bytes")


if __name__ == "__main__":
    main()
