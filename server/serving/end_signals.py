"""Signals that end a command."""

from __future__ import annotations

import signal

_END = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT)


def end_signals() -> tuple[signal.Signals, ...]:
    """Return the signals that end a command in an orderly way.

    SIGHUP is left out if it is already ignored, as with `nohup`.
    """
    return tuple(one for one in _END if one != signal.SIGHUP or signal.getsignal(one) is not signal.SIG_IGN)
