"""What a command is doing while it prints nothing: one line on a terminal after 1.2 s without output.

Loading the program and reading logs can take longer than a person waits. A stage is printed at most once, and only if
nothing was printed since it began: a command that is fast, or that shows its progress, prints none. Without a terminal
nothing is printed.
"""

from __future__ import annotations

import sys
import threading
import time

from rig_cli import streams

_QUIET_S = 1.2
_FIRST = "loading the program, which takes longer at the first start after an installation"


class _Stages:
    """The current stage, and the thread that prints it."""

    def __init__(self) -> None:
        self._command, self._text = "rig", ""
        self._began_s = self._quiet_since_s = 0.0
        self._changed = threading.Condition()

    def watch(self, command: str) -> None:
        """Start the thread, with the loading of the program as first stage."""
        self._command = command
        self._quiet_since_s = time.monotonic()
        self.begin(_FIRST)
        threading.Thread(target=self._print_stages, name="stages", daemon=True).start()

    def begin(self, text: str) -> None:
        """Begin a stage; the empty text ends the last one."""
        with self._changed:
            self._text, self._began_s = text, time.monotonic()
            self._changed.notify_all()

    def _print_stages(self) -> None:
        with self._changed:
            while True:
                printed_s = streams.last_output_s()
                left_s = max(printed_s, self._quiet_since_s) + _QUIET_S - time.monotonic()
                if not self._text or printed_s > self._began_s:  # nothing to print until the next stage
                    self._changed.wait()
                elif left_s > 0:
                    self._changed.wait(left_s)
                else:
                    sys.stderr.write(f"{self._command}: {self._text} …\n")
                    self._text = ""


_stages = _Stages()


def watch_stages(arguments: list[str]) -> None:
    """Print the stages of a command, if its messages go to a terminal.

    Args:
        arguments: of the command line.
    """
    if sys.stderr.isatty():
        name = next(iter(arguments), "")
        _stages.watch(f"rig {name}" if name.isalpha() else "rig")


def begin_stage(text: str) -> None:
    """Begin a stage, which is printed if nothing else is for 1.2 s.

    Args:
        text: what is done, for example "reading 3 logs"; empty: no stage.
    """
    _stages.begin(text)
