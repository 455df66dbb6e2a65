"""Numbers before the names of logs in a folder, counted up: 01-ring-down-x.mcap, 02-…, 100-…."""

from __future__ import annotations

import logging
import os
import re
import sys
from collections.abc import Generator, Iterable
from contextlib import contextmanager
from pathlib import Path

from rig_basics.ignoring import ignoring

if sys.platform != "win32":
    import fcntl

_log = logging.getLogger(__name__)

_NUMBERED = re.compile(r"([0-9]{1,6})-.*\.mcap", re.DOTALL)  # more digits are a date or a serial number
_LARGEST = 999_999


def next_number(names: Iterable[str]) -> int:
    """Return the number after the largest of the logs in a folder, of any number of digits; 1 for no logs.

    Args:
        names: names in the folder; finished logs, cut ones and files that belong to them count, others do not.
    """
    found = (_NUMBERED.match(name) for name in names)
    return 1 + max((n for match in found if match and (n := int(match[1])) < _LARGEST), default=0)


@contextmanager
def one_at_a_time(folder: Path) -> Generator[None]:
    """Lock a folder while a log in it gets its number and its name, so that two tests never get the same number.

    Where a folder cannot be locked (Windows, some network drives), only the log's complete name is guarded.
    """
    if sys.platform == "win32":
        yield
        return
    try:
        descriptor = os.open(folder, os.O_RDONLY)
    except OSError as error:
        _log.debug("%s: not locked while a log gets its number: %s", folder, error)
        yield
        return
    try:
        with ignoring(_log, f"locking {folder}", OSError):
            fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield
    finally:
        os.close(descriptor)
