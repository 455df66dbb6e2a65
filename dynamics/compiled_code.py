"""Where compiled code is kept between runs: one directory for each state of the sources.

numba looks only at the file that holds a function, not at what that function calls: after a change in a kernel, code
compiled from its callers before would go on running the old one, and a wheel's files all bear one date. The directory
is therefore named after a digest of every source that is compiled.

The `rig` command, the tests and the benchmarks ask for that directory, before they compile anything. Importing the
packages does not: a program that uses them keeps its own numba settings, and may call keep_compiled_code itself.
"""

from __future__ import annotations

import atexit
import hashlib
import importlib
import os
import shutil
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

_COMPILED = ("dynamics", "identification", "daq/virtual_rig")
_KEPT_S = 60 * 86400.0  # directories of other versions not used for that long are removed


def keep_compiled_code() -> Path | None:
    """Point numba's cache at this version's own directory; a NUMBA_CACHE_DIR that is set stays.

    To be called before a module that compiles is imported; it hashes the sources (some 20 ms).

    Returns:
        The directory, one of this process alone where the user's cache directory can't be written to; None when the
        cache stays where the user has put it.
    """
    if os.environ.get("NUMBA_CACHE_DIR"):
        return None
    place = _user_cache() / "pendulum-balancer-rig" / f"compiled-{source_digest()}"
    try:
        place.mkdir(parents=True, exist_ok=True)
        os.utime(place)
        tempfile.TemporaryFile(dir=place).close()
        _forget_old(place)
    except (OSError, RuntimeError):  # RuntimeError: there is no home
        place = Path(tempfile.mkdtemp(prefix="pendulum-balancer-rig-"))
        atexit.register(shutil.rmtree, place, ignore_errors=True)
    os.environ["NUMBA_CACHE_DIR"] = str(place)  # child processes too
    if "numba" in sys.modules:
        sys.modules["numba"].config.CACHE_DIR = str(place)
    return place


def load_compiler() -> None:
    """Import what numba needs to run compiled code, without scipy's linear algebra.

    numba asks on import whether scipy has a BLAS, which loads scipy.linalg: 0.15 s of a command that may never call it.
    scipy is a dependency, so the answer is known; what numba checks of it besides (the width of its integers) is
    checked all the same. Compiled code that calls LAPACK loads it when it does.
    """
    if "numba.np.arraymath" in sys.modules or "scipy.linalg" in sys.modules:
        return
    linalg: Any = importlib.import_module("numba.np.linalg")
    asked = linalg.ensure_blas
    linalg.ensure_blas = getattr(linalg, "_check_lapack_int_width", lambda: None)
    try:
        importlib.import_module("numba.np.arraymath")
    finally:
        linalg.ensure_blas = asked


def source_digest() -> str:
    """Sixteen hexadecimal digits that change with any source that is compiled."""
    root, found = Path(__file__).parents[1], hashlib.sha256(sys.version.encode())
    for package in _COMPILED:
        for path in sorted((root / package).rglob("*.py")):
            found.update(path.relative_to(root).as_posix().encode())
            found.update(path.read_bytes())
    return found.hexdigest()[:16]


def _user_cache() -> Path:
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA") or Path.home() / "AppData" / "Local")
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Caches"
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")


def _forget_old(current: Path) -> None:
    for other in current.parent.glob("compiled-*"):
        if other != current and time.time() - other.stat().st_mtime > _KEPT_S:
            shutil.rmtree(other, ignore_errors=True)
