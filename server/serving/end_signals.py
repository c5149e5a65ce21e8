"""The signals that ask a command to end."""

from __future__ import annotations

import signal

_END = ("SIGINT", "SIGTERM", "SIGHUP", "SIGQUIT")


def end_signals() -> tuple[signal.Signals, ...]:
    """Return the signals that end a command in order, as far as this system has them.

    SIGHUP is left out where it is ignored already: that is what `nohup` asks for.
    """
    found = [signal.Signals[name] for name in _END if name in signal.Signals.__members__]
    return tuple(one for one in found if one.name != "SIGHUP" or signal.getsignal(one) is not signal.SIG_IGN)
