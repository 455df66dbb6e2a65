"""Who works tiles out: threads of this process, processes of this machine, or dask's workers anywhere."""

from __future__ import annotations

from collections.abc import Callable

from studies.errors import StudyInputError
from studies.running import Engine

_EXPECTED = "expected local:N with N processes, or a scheduler's address as tcp://HOST:PORT or tls://HOST:PORT"


def engine_of(text: str, tell: Callable[[str], None]) -> Engine:
    """The engine that `--scheduler` names.

    Args:
        text: local:N, tcp://HOST:PORT or tls://HOST:PORT.
        tell: told what the user should know, in a sentence.
    Raises:
        StudyInputError: it is neither.
        EngineMissing: dask is not installed.
    """
    head, sign, rest = text.partition(":")
    if head == "local":
        from studies.engines.processes import Processes  # noqa: PLC0415 (each engine costs its own imports)

        if not (sign and rest.isdecimal() and 1 <= int(rest) <= 1024):
            raise StudyInputError(f"--scheduler {text!r}: {_EXPECTED}")
        return Processes(int(rest), tell)
    if text.startswith(("tcp://", "tls://")):
        from studies.engines.dask_workers import DaskWorkers  # noqa: PLC0415

        return DaskWorkers(text, tell)
    raise StudyInputError(f"--scheduler {text!r}: {_EXPECTED}")
