"""The one JSON object that a command with `--json` prints on standard output, for results and for errors.

This module needs only the standard library: it can report that any other module fails to load.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from rig_cli.streams import OutputLost, discard_results


@dataclass
class _Answer:
    """State of the running command's answer.

    Attributes:
        wanted: whether the arguments request JSON.
        given: whether the object has been printed.
        fault: text and exit code of an error of the program itself; None without one.
        names_fault: whether the printed object contains the fault.
    """

    wanted: bool = False
    given: bool = False
    fault: tuple[str, int] | None = None
    names_fault: bool = False

    def begin(self, wanted: bool) -> None:
        """Start a new command."""
        self.wanted, self.given, self.fault, self.names_fault = wanted, False, None, False


_answer = _Answer()


def begin(arguments: Sequence[str]) -> None:
    """Start the answer of a new command."""
    _answer.begin(any(a in ("--json", "--json=true", "--json=True") for a in arguments))


def give(result: Mapping[str, Any]) -> None:
    """Print the result. After a fault in a thread the object also contains the fault and its exit code."""
    if _answer.fault is not None:
        text, code = _answer.fault
        result, _answer.names_fault = {"error": text, "exit_code": code, **result}, True
    _print(result)


def announce(result: Mapping[str, Any]) -> None:
    """Print a line before the answer, for example the address of a page while the command runs."""
    print(json.dumps(result), flush=True)


def give_error(text: str, code: int) -> None:
    """Print an error object if JSON is requested and no object has been printed.

    If standard output cannot be written, the text on standard error and the exit code are all that remains.

    Args:
        text: what was expected, what was found, what to do.
        code: the command's exit code.
    """
    if _answer.wanted and not _answer.given:
        try:
            _print({"error": text, "exit_code": code})
        except OutputLost:  # usual: the error is that standard output cannot be written
            discard_results()


def note_fault(text: str, code: int) -> None:
    """Record a fault of the program. Only the first one is kept.

    Args:
        text: what happened, and what to send to the developers.
        code: exit code of such a fault.
    """
    _answer.fault = _answer.fault or (text, code)


def ended(code: int) -> int:
    """Return the exit code of a command that ends with `code`.

    After a fault it is the fault's code if `code` is 0 or if the printed result contains the fault.
    """
    if _answer.fault is None or (code != 0 and not _answer.names_fault):
        return code
    give_error(*_answer.fault)
    return _answer.fault[1]


def _print(result: Mapping[str, Any]) -> None:
    print(json.dumps(result), flush=True)
    _answer.given = True
