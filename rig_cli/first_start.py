"""The first start after an installation: compiles what the usual commands need, before a person waits for it.

`make setup` runs this module and waits. The first analysis by a wheel starts it in the background. A file in the
directory of the compiled code marks that it was started, so a change of the compiled sources starts it again.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from pathlib import Path

from dynamics.compiled_code import keep_compiled_code, keeps_code

_MARK = "first-start"
_COMMANDS = (("predict", "virtual", "--point", "B"), ("demo",))
_LOWEST_PRIORITY = 19  # of POSIX: the background yields to every other process
_MODULE = "rig_cli.first_start"
_BACKGROUND = "--background"


def compile_in_background(place: Path | None) -> bool:
    """Start the compilation in a process of its own, unless it was started before.

    Args:
        place: directory of the compiled code; None: the user's own, which is left alone.
    Returns:
        Whether a process was started. It outlives this one, has the lowest priority and prints nothing.
    """
    if place is None or not keeps_code(place) or (place / _MARK).exists():
        return False
    # on Linux a session of its own has its own share of the processor, at any priority
    windows = getattr(subprocess, "IDLE_PRIORITY_CLASS", 0) | getattr(subprocess, "CREATE_NEW_PROCESS_GROUP", 0)
    subprocess.Popen(
        [sys.executable, "-m", _MODULE, _BACKGROUND],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        process_group=None if sys.platform == "win32" else 0,  # Ctrl-C does not end it
        creationflags=windows,
    )
    return True


def main() -> int:
    """Run the usual commands once, each in a process of its own and in a temporary folder; the exit code."""
    place = keep_compiled_code() or Path(os.environ["NUMBA_CACHE_DIR"])
    if not _begun(place):
        return 0
    if _BACKGROUND in sys.argv and sys.platform != "win32":
        os.nice(_LOWEST_PRIORITY)
    print("compiling what the usual commands need, once after an installation: minutes", file=sys.stderr)
    with tempfile.TemporaryDirectory(prefix="rig-first-start-") as folder:
        codes = [
            subprocess.run(
                [sys.executable, "-m", "rig_cli.entry", *command], cwd=folder, stdout=subprocess.DEVNULL, check=False
            ).returncode
            for command in _COMMANDS
        ]
    return max(codes)


def _begun(place: Path) -> bool:
    """Write the mark; False if another process has written it."""
    place.mkdir(parents=True, exist_ok=True)
    try:
        (place / _MARK).touch(exist_ok=False)
    except FileExistsError:  # usual: compiled before
        return False
    return True


if __name__ == "__main__":
    sys.exit(main())
