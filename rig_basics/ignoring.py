"""A context that ignores errors and leaves a line about each in the log of the program."""

from __future__ import annotations

import logging
from types import TracebackType
from typing import final


@final
class ignoring:  # noqa: N801 (used like contextlib.suppress)
    """Ignore errors of the given types; each leaves a line at level DEBUG.

        with ignoring(_log, "closing the port", OSError):
            port.close()

    Args:
        log: logger of the module.
        activity: what is done, as the start of the line.
        errors: types of the errors.
    """

    def __init__(self, log: logging.Logger, activity: str, *errors: type[BaseException]) -> None:
        self._log, self._activity, self._errors = log, activity, errors

    def __enter__(self) -> None:
        """Do nothing."""

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> bool:
        """Return whether the error is ignored."""
        del traceback
        if kind is None or not issubclass(kind, self._errors):
            return False
        self._log.debug("%s: ignored %s: %s", self._activity, kind.__name__, error)
        return True
