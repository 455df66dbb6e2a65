"""Writing of a file that is complete or does not exist: under another name, then renamed."""

from __future__ import annotations

import logging
import os
import secrets
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path

from rig_basics.ignoring import ignoring
from rig_basics.texts import storable

_log = logging.getLogger(__name__)


@contextmanager
def written_whole(path: str | Path) -> Generator[Path]:
    """Return a context with the path under which a file is written; it gets its own name when the block is left.

    The path has the ending of the file, since writers take the format from it. An existing file is replaced in one
    step, keeps its permissions, and is left as it is if the block raises or the disk is full. A link stays a link. A
    device or a pipe is written directly.

    Raises:
        OSError: the file cannot be written.
    """
    final = Path(path).resolve()
    if final.exists() and not final.is_file():
        yield final
        return
    part = final.with_name(f".{final.stem[:100]}.{secrets.token_hex(4)}.part{final.suffix}")
    try:
        yield part
        with open(part, "rb+") as file:
            os.fsync(file.fileno())
        if final.exists():
            part.chmod(final.stat().st_mode & 0o777)
        os.replace(part, final)
    except BaseException:
        with ignoring(_log, f"removing {part}", OSError):
            part.unlink(missing_ok=True)
        raise


def write_whole_text(path: str | Path, text: str) -> None:
    """Write a text file in UTF-8, as `storable` returns the text; see `written_whole`."""
    with written_whole(path) as part:
        part.write_text(storable(text), encoding="utf-8")
