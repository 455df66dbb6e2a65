# pyright: strict
"""The one JSON object that a command with `--json` puts on standard output, whatever becomes of the command.

It needs nothing that may fail to load, so that what fails to load can be answered too.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any


@dataclass
class _Answer:
    """How the running command stands.

    Attributes:
        wanted: whether its arguments ask for JSON.
        given: whether the object has gone out.
        fault: why the program itself is at fault, in words, with the exit code; None as long as it is not.
        names_fault: whether the object that has gone out says so.
    """

    wanted: bool = False
    given: bool = False
    fault: tuple[str, int] | None = None
    names_fault: bool = False


_answer = _Answer()


def begin(arguments: Sequence[str]) -> None:
    """A command begins."""
    global _answer  # noqa: PLW0603 (one command runs at a time, and it has one standard output)
    _answer = _Answer(wanted=any(a in ("--json", "--json=true", "--json=True") for a in arguments))


def give(result: Mapping[str, Any]) -> None:
    """Print the result; where a thread died before, with what happened: the command ends with that."""
    if _answer.fault is not None:
        text, code = _answer.fault
        result, _answer.names_fault = {"error": text, "exit_code": code, **result}, True
    _print(result)


def announce(result: Mapping[str, Any]) -> None:
    """Print what goes before the answer, as a line of its own: where to look while the command runs."""
    print(json.dumps(result), flush=True)


def give_error(text: str, code: int) -> None:
    """Print why there is no result, where JSON is wanted and no object has gone out.

    Args:
        text: what was expected, what came, what to do.
        code: the command's exit code.
    """
    if _answer.wanted and not _answer.given:
        _print({"error": text, "exit_code": code})


def note_fault(text: str, code: int) -> None:
    """The program is at fault; the first fault counts.

    Args:
        text: what happened, and what to send.
        code: the exit code of such a fault.
    """
    _answer.fault = _answer.fault or (text, code)


def ended(code: int) -> int:
    """The exit code of a command that would end with this one: a fault's in place of 0, and where the result has it."""
    if _answer.fault is None or (code != 0 and not _answer.names_fault):
        return code
    give_error(*_answer.fault)
    return _answer.fault[1]


def _print(result: Mapping[str, Any]) -> None:
    print(json.dumps(result), flush=True)
    _answer.given = True
