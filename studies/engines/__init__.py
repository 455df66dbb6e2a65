"""Engines that compute tiles: threads of this process, processes of this machine, or dask's workers on any host."""

from __future__ import annotations

from collections.abc import Callable

from studies.engines.dask_workers import DaskWorkers
from studies.engines.processes import Processes
from studies.errors import StudyInputError
from studies.running import Engine

_EXPECTED = "expected local:N with N processes, or a scheduler's address as tcp://HOST:PORT or tls://HOST:PORT"


def engine_of(text: str, notify: Callable[[str], None]) -> Engine:
    """Return the engine that a text names.

    Args:
        text: local:N, tcp://HOST:PORT or tls://HOST:PORT.
        notify: called with a sentence for the user.
    Raises:
        StudyInputError: the text has another form.
        EngineMissing: dask is not installed.
    """
    head, sign, rest = text.partition(":")
    if head == "local":
        if not (sign and rest.isdecimal() and 1 <= int(rest) <= 1024):
            raise StudyInputError(f"scheduler {text!r}: {_EXPECTED}")
        return Processes(int(rest), notify)
    if text.startswith(("tcp://", "tls://")):
        return DaskWorkers(text, notify)
    raise StudyInputError(f"scheduler {text!r}: {_EXPECTED}")
