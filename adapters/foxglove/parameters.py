"""The parameters of a Foxglove server."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Mapping, Sequence
from typing import Protocol

from rosld.adapters.foxglove.graph import Peer
from rosld.adapters.model import NotFound, ParameterValue, Refused, Sent
from rosld.adapters.model import foxglove_protocol as protocol


class Request(Protocol):
    """A request about parameters, whose answer has their values by ROS name."""

    def __call__(self, operation: str, until: float, **members: object) -> Awaitable[Mapping[str, ParameterValue]]: ...


class Parameters:
    """Reads and sets parameters by requests; `changed` is called after each that set some."""

    def __init__(self, peer: Callable[[], Peer], request: Request, changed: Callable[[], None]) -> None:
        self._peer = peer
        self._request = request
        self._refresh = changed

    async def get(self, names: Sequence[str], until: float) -> Mapping[str, ParameterValue]:
        """Return the current values of parameters, and trees of those below other names."""
        peer = self._peer()
        known = peer.parameters
        if not names or not peer.can("parameters"):
            return {}
        below = {name: [each for each in known if each.startswith(f"{name.rstrip('/')}/")] for name in names}
        wanted = dict.fromkeys(each for name in names for each in (name, *below[name]) if each != "/")
        values = await self._request(
            "getParameters", until, parameterNames=[known[each][0] if each in known else each for each in wanted]
        )
        found: dict[str, ParameterValue] = {}
        for name in names:
            if name in values:
                found[name] = values[name]
            elif inner := {each: values[each] for each in below[name] if each in values}:
                found[name] = _tree(name, inner)
        return found

    async def set(self, values: Mapping[str, ParameterValue | None], until: float) -> None:
        """Set parameters; None deletes one. Raises Refused naming a parameter that did not change as requested."""
        peer = self._peer()
        if not peer.can("parameters"):
            raise Refused("the Foxglove server has no parameters")
        known, peer.words = peer.parameters, None
        written = {name: known[name][0] if name in known else name for name in values}
        entries = [protocol.parameter_entry(written[name], value) for name, value in values.items()]
        now = await self._request("setParameters", until, parameters=entries)
        for name, value in values.items():
            if value is None:
                known.pop(name, None)
            if now.get(name) != value:
                words = f"the parameter {name} was not {'deleted' if value is None else 'set'}"
                raise Refused(words, words=peer.words, sent=Sent.YES)
        self._refresh()

    async def delete(self, names: Sequence[str], until: float) -> None:
        """Delete parameters. Raises NotFound, and Refused if the server does not delete one."""
        for name in names:
            if name not in self._peer().parameters:
                raise NotFound(f"there is no parameter {name!r}")
        await self.set(dict.fromkeys(names), until)


def _tree(name: str, values: Mapping[str, ParameterValue]) -> ParameterValue:
    """Return values as a tree below a name."""
    tree: dict[str, ParameterValue] = {}
    for each, value in values.items():
        *above, last = each[len(name.rstrip("/")) + 1 :].split("/")
        place = tree
        for step in above:
            below = place.setdefault(step, {})
            if not isinstance(below, dict):
                below = place[step] = {}
            place = below
        place[last] = value
    return tree
