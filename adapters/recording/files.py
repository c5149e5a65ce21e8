"""Opening whatever is a recording: the format is told by the first bytes of a file, not by its name."""

from __future__ import annotations

from pathlib import Path

from rosld.adapters.model import NotFound, Unreachable
from rosld.adapters.model.mcap import MAGIC
from rosld.adapters.recording import mcap, rosbag1, rosbag2, sqlite
from rosld.adapters.recording.open_budget import OpenBudget, OpeningRefused
from rosld.adapters.recording.storage import Damaged, Storage


def open_storage(path: Path, budget: OpenBudget | None = None) -> Storage:
    """The recording at `path`. Raises NotFound, or Unreachable with a sentence that says what is wrong with it."""
    budget = OpenBudget() if budget is None else budget
    if not path.exists():
        raise NotFound(f"there is no recording {str(path)!r}")
    try:
        return rosbag2.Rosbag2(path, open_file, budget) if path.is_dir() else open_file(path, budget)
    except (Damaged, OpeningRefused) as damage:
        raise Unreachable(f"{str(path)!r} cannot be read as a recording: {damage}") from damage
    except OSError as error:
        raise Unreachable(f"{str(path)!r} cannot be opened: {error.strerror or error}") from error


def open_file(path: Path, budget: OpenBudget) -> Storage:
    """The recording in one file. Raises Damaged, OpeningRefused and OSError."""
    budget.allow(path.stat().st_size)
    with path.open("rb") as file:
        head = file.read(16)
    if not head:
        raise Damaged("the file is empty")
    if head.startswith(rosbag1.MAGIC):
        return rosbag1.Rosbag1(path, budget)
    if head.startswith(MAGIC):
        return mcap.Mcap(path, budget)
    if head.startswith(sqlite.MAGIC):
        return sqlite.Sqlite(path, budget)
    raise Damaged("it is neither a ROS 1 bag nor an MCAP file nor a ROS 2 database")


def recording_name(path: Path) -> str:
    """The name of a recording: its file's without the suffix (of an unfinished `x.bag.active` too), or its folder's."""
    resolved = path.resolve()
    name = resolved.name if resolved.is_dir() else resolved.name.removesuffix(".active")
    stem = name if resolved.is_dir() else Path(name).stem
    return stem or "recording"
