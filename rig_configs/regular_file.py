# pyright: strict
"""Opening files that somebody else named: only real files, looked at before they are opened.

Opening a named pipe waits for whoever writes to it, a device may begin to do something, and neither has an end.
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
    """Refuse what is no file.

    Raises:
        OSError: nothing of that name, or something that is no file; its `strerror` says what it is.
    """
    mode = os.stat(path).st_mode
    if not stat.S_ISREG(mode):
        what = next((text for is_kind, text in _KINDS if is_kind(mode)), "it is no file")
        code = errno.EISDIR if stat.S_ISDIR(mode) else errno.EINVAL
        raise OSError(code, what, str(path))
