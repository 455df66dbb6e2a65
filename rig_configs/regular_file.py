"""Opening of files with names from outside: only regular files, checked before they are opened.

Opening a named pipe waits for its writer, opening a device may start an action, and neither has an end.
"""

from __future__ import annotations

import errno
import os
import stat
from pathlib import Path

_KINDS = (
    (stat.S_ISDIR, "it is a directory, not a file"),
    (stat.S_ISFIFO, "it is a named pipe, not a file"),
    (stat.S_ISSOCK, "it is a socket, not a file"),
    (stat.S_ISCHR, "it is a device, not a file"),
    (stat.S_ISBLK, "it is a disk, not a file"),
)


def need_regular(path: str | Path) -> None:
    """Check that a path is a regular file.

    Raises:
        OSError: the path does not exist, or is not a regular file; its `strerror` contains the kind.
    """
    mode = os.stat(path).st_mode
    if not stat.S_ISREG(mode):
        what = next((text for is_kind, text in _KINDS if is_kind(mode)), "it is not a file")
        code = errno.EISDIR if stat.S_ISDIR(mode) else errno.EINVAL
        raise OSError(code, what, str(path))
