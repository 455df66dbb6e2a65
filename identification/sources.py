"""Logs of a test. A test has several logs if they were fitted together."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

Sources = tuple[str, ...]
"""Paths of the logs of one test, or their names."""

_JOINT = " + "


def joined(sources: Sequence[str]) -> str:
    """Return one text with the logs as they are given."""
    return _JOINT.join(sources)


def log_names(sources: Sequence[str]) -> str:
    """Return one text with the file names of the logs."""
    return _JOINT.join(Path(source).name for source in sources)


def parts(text: str) -> Sources:
    """Return the logs, or the digests, of a text in a parameters file that `joined` or `log_names` has written."""
    return tuple(text.split(_JOINT))
