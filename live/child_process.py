"""What the processes of the page and of the Foxglove connection have in common."""

from __future__ import annotations

import signal


def ignore_terminal_signals() -> None:
    """Ignore what a terminal sends to all its processes; the session's process decides when to end."""
    for name in ("SIGINT", "SIGHUP"):
        if hasattr(signal, name):  # Windows has no SIGHUP
            signal.signal(getattr(signal, name), signal.SIG_IGN)
