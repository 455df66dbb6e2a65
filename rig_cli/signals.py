"""Signals that end a command. The first interrupts it; when its work is done, the next one ends the program at once."""

from __future__ import annotations

import atexit
import os
import signal
import sys
import threading

dropped: list[str] = []
"""Names of the signals whose interruption was dropped, "" for Ctrl-C: a callback of a library can raise no error. The
compiler then fails in another way."""
_AGAIN_S = 0.1
# Windows has no SIGHUP.
_INTERRUPTING = [getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name)]


def interrupt_at_signals() -> None:
    """Let SIGTERM and SIGHUP end a command as Ctrl-C does: the log is finished and the rotor stopped.

    A signal that is ignored at the start stays ignored: `nohup` keeps a recording when the terminal is closed.
    """
    for number in _INTERRUPTING:
        if signal.getsignal(number) != signal.SIG_IGN:
            signal.signal(number, _interrupt)
    sys.unraisablehook = note_dropped


def end_at_next_signal(code: int) -> None:
    """End the program with this code at the next signal, while only the interpreter is not yet ended."""
    for number in (signal.SIGINT, *_INTERRUPTING):
        signal.signal(number, lambda number, frame: os._exit(code))


def end_without_threads(code: int) -> None:
    """End the program with this code at once, if threads still compute after an interruption.

    Otherwise the interpreter would wait for them, and compiled code cannot be interrupted. As daemon threads they would
    run in an interpreter that has ended. What is registered for the end of the program is done.
    """
    if any(not thread.daemon for thread in threading.enumerate() if thread is not threading.main_thread()):
        atexit._run_exitfuncs()  # pyright: ignore[reportPrivateUsage] (only the end of the interpreter does it otherwise)
        os._exit(code)


def note_dropped(fault: sys.UnraisableHookArgs) -> None:
    """Note an interruption that cannot be raised where it arrived, and send it again; print other such errors."""
    if issubclass(fault.exc_type, KeyboardInterrupt):
        dropped.append(str(fault.exc_value or ""))
        send_again(signal.Signals[dropped[-1] or "SIGINT"])
    else:
        sys.__unraisablehook__(fault)


def ignore_unfinished() -> None:
    """Print no errors of objects that an interruption left half made, such as a compiler's, when they are deleted."""
    if sys.unraisablehook is note_dropped:  # in the command, not in a program that calls its functions
        sys.unraisablehook = lambda fault: None


def send_again(number: signal.Signals) -> None:
    """Send a signal to the main thread in a moment, when it has left the callback that dropped the first one."""
    if hasattr(signal, "pthread_kill"):
        again = threading.Timer(_AGAIN_S, signal.pthread_kill, (threading.main_thread().ident, number))
        again.daemon = True
        again.start()


def _interrupt(number: int, frame: object) -> None:
    raise KeyboardInterrupt(signal.Signals(number).name)
