"""Signals that end a command. The first interrupts it; when its work is done, the next one ends the program at once."""

from __future__ import annotations

import os
import signal

received: list[str] = []
"""Names of the signals that came, "" for Ctrl-C. An error after one may be its consequence: callbacks of libraries drop
the interruption, or turn it into another error."""
# Windows has no SIGHUP.
_INTERRUPTING = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]


def interrupt_at_signals() -> None:
    """Let SIGTERM and SIGHUP end a command as Ctrl-C (SIGINT) does: the log is finished and the rotor stopped.

    A signal that is ignored at the start stays ignored: `nohup` keeps a recording when the terminal is closed.
    """
    for number in _INTERRUPTING:
        if signal.getsignal(number) != signal.SIG_IGN:
            signal.signal(number, _interrupt)


def end_at_next_signal(code: int) -> None:
    """End the program with this code at the next signal, while only the interpreter is not yet ended."""
    for number in _INTERRUPTING:
        signal.signal(number, lambda number, frame: os._exit(code))


def _interrupt(number: int, frame: object) -> None:
    received.append("" if number == signal.SIGINT else signal.Signals(number).name)
    raise KeyboardInterrupt(received[-1])
