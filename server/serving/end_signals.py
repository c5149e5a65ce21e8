"""The signals that ask a command to end."""

from __future__ import annotations

import signal

_END = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT)


def end_signals() -> tuple[signal.Signals, ...]:
    """Return the signals that end a command in order.

    SIGHUP is left out where it is ignored already: that is what `nohup` asks for.
    """
    return tuple(one for one in _END if one != signal.SIGHUP or signal.getsignal(one) is not signal.SIG_IGN)
