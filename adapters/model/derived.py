"""Types that ROS 2 derives from written ones: what actions are sent by, and what services tell of their calls. Pure.

An action `pkg/action/Fly` is the services `Fly_SendGoal` and `Fly_GetResult` and the message `Fly_FeedbackMessage`
(design.ros2.org, "Actions"); a service `pkg/srv/Trigger`, and each of an action's, tells of its calls in messages
`Trigger_Event` (REP 2012, "Service Introspection").
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal, TypeAlias

WrittenType: TypeAlias = Literal["msg", "srv", "action"]

_UUID = "unique_identifier_msgs/UUID goal_id"
_OF_ACTIONS = {
    "_SendGoal": f"{_UUID}\n{{of}}_Goal goal\n---\nbool accepted\nbuiltin_interfaces/Time stamp",
    "_GetResult": f"{_UUID}\n---\nint8 status\n{{of}}_Result result",
    "_FeedbackMessage": f"{_UUID}\n{{of}}_Feedback feedback",
}
_OF_SERVICES = {
    "_Event": "service_msgs/ServiceEventInfo info\n{of}_Request[<=1] request\n{of}_Response[<=1] response",
}
_SERVICES_OF_ACTIONS = ("_SendGoal", "_GetResult")
_HALVES = ("_Request", "_Response")
_THIRDS = ("_Goal", "_Result", "_Feedback")


def derived_from(name: str) -> tuple[str, str] | None:
    """The type that a type is derived from, and its text, which names what it nests in full; None for all others."""
    kind = _folder(name)
    ends: Mapping[str, str] = {}
    if kind == "srv" or (kind == "action" and name.endswith(tuple(f"{each}_Event" for each in _SERVICES_OF_ACTIONS))):
        ends = _OF_SERVICES
    elif kind == "action":
        ends = _OF_ACTIONS
    for end, text in ends.items():
        if name.endswith(end):
            of = name.removesuffix(end)
            return of, text.format(of=of)
    return None


def written_form(name: str) -> WrittenType:
    """How the definition of a type is written: that of an action's service is a service's."""
    kind = _folder(name)
    if kind == "action" and derived_from(name) is None:
        return "action"
    is_service = name.endswith(_SERVICES_OF_ACTIONS) if kind == "action" else kind == "srv" and not derived_from(name)
    return "srv" if is_service else "msg"


def enclosing_type(name: str) -> str | None:
    """The service or action type that a message is a part of, None for all others."""
    kind = _folder(name)
    if kind == "action":
        ends = (*_THIRDS, *(f"{service}{half}" for service in _SERVICES_OF_ACTIONS for half in _HALVES))
        found = next((end for end in ends if name.endswith(end)), None)
        return None if found is None else name.removesuffix("_" + found.rpartition("_")[2])
    return next((name.removesuffix(end) for end in _HALVES if kind == "srv" and name.endswith(end)), None)


def _folder(name: str) -> str:
    return name.partition("/")[2].partition("/")[0]
