"""ROS graph names: slash-separated paths such as `/camera/image_raw`.

rosld accepts every Unicode name that a master can hold, even those that ROS's own rules would refuse
(they exist in the wild); only the empty name and names without a leading slash are not global names.
"""

from __future__ import annotations


def segments(name: str) -> tuple[str, ...]:
    """Return the segments of a global name: `/a/b` has two, `/` none, `/a//b` three with an empty one between.

    Raises ValueError for a name that does not begin with a slash.
    """
    if not name.startswith("/"):
        raise ValueError(f"{name!r} is not a global ROS name: it must begin with '/'")
    return () if name == "/" else tuple(name[1:].split("/"))


def join(parts: tuple[str, ...]) -> str:
    """Return the global name of these segments: the inverse of `segments`."""
    return "/" + "/".join(parts)


def global_name(name: str) -> str:
    """Return the name with a leading slash, as the master stores it."""
    return name if name.startswith("/") else "/" + name


def is_hidden(name: str) -> bool:
    """Whether ROS 2 hides a name from listings: a segment of it begins with an underscore."""
    return "/_" in name


def action_of(name: str) -> str | None:
    """Return the ROS 2 action whose inner topic or service has this name, or None."""
    action, found, _ = name.rpartition("/_action/")
    return action if found and action else None
