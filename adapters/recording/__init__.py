"""Recordings: `rosld serve run.bag`, a ROS 2 folder, an `.mcap` or a `.db3` file."""

from pathlib import Path

from rosld.adapters.base import Adapter, AdapterOptions
from rosld.adapters.recording.adapter import RecordingAdapter

_SCHEME = "recording:"


def adapter(source: str, options: AdapterOptions) -> Adapter:
    """The adapter of a recording's path, `recording:` before it or not. Raises ValueError for options out of range."""
    path = Path(source)
    if source.startswith(_SCHEME) and not path.exists():
        path = Path(source.removeprefix(_SCHEME))
    return RecordingAdapter(path.expanduser(), options)


__all__ = ["RecordingAdapter", "adapter"]
