"""Directory of the compiled code between runs: one directory for each state of the sources.

numba checks only the file that contains a function, not the functions called by it nor the numbers that it takes from
other files. After a change in a kernel or in such a number, cached code of its callers would contain the old one. All
files of a wheel have the same date. Therefore the directory is named after a digest of all sources that compiled
functions are made of (`rig_basics.compiled_sources`), of the compiler's versions and of its options. numba itself
distinguishes processors.

The `rig` command, the tests and the benchmarks set this directory before they compile anything. Importing the packages
does not set it: a program that uses them keeps its own numba settings and can call `keep_compiled_code`.
"""

from __future__ import annotations

import atexit
import hashlib
import importlib
import logging
import os
import shutil
import sys
import tempfile
import time
from collections.abc import Callable
from functools import partial
from importlib.machinery import PathFinder
from pathlib import Path
from typing import Any, ParamSpec, TypeVar, overload

from rig_basics.compiled_sources import compiled_sources

_log = logging.getLogger(__name__)

P = ParamSpec("P")
R = TypeVar("R")

_ROOT = Path(__file__).parents[1]
_COMPILER = {"numba": "_version.py", "llvmlite": "_version.py", "numpy": "version.py"}  # files with the versions
_NOT_OPTIONS = {"NUMBA_CACHE_DIR", "NUMBA_NUM_THREADS"}  # variables of the environment without effect on the code
_KEPT = "compiled-"  # beginning of the names of directories that outlive their process
_MAX_UNUSED_S = 60 * 86400.0  # directories of other versions that were not used for this time are removed, s


@overload
def compiled(function: Callable[P, R], /) -> Callable[P, R]: ...


@overload
def compiled(
    *, nogil: bool = False, contract: bool = False, part: bool = False
) -> Callable[[Callable[P, R]], Callable[P, R]]: ...


def compiled(
    function: Callable[..., Any] | None = None,
    /,
    *,
    nogil: bool = False,
    contract: bool = False,
    part: bool = False,
) -> Callable[..., Any]:
    """Compile a function with numba when it is first called. The code is cached between runs.

    The decorator keeps the function's signature for type checkers. numba itself ignores the annotations and compiles
    one version for each combination of argument types. A division by zero yields inf or NaN, as in numpy.

    Args:
        function: the function, for use without parentheses.
        nogil: release the interpreter lock during the call.
        contract: let the compiler merge a product and a sum into one operation, which is rounded once.
        part: only compiled functions call it. Python runs it uncompiled: without an entry from Python it compiles in
            two thirds of the time.
    """
    numba: Any = importlib.import_module("numba")
    options: dict[str, Any] = {"cache": True, "error_model": "numpy", "no_cfunc_wrapper": True}
    if contract:
        options["fastmath"] = {"contract"}
    decorate: Callable[..., Any] = partial(_as_part, options) if part else numba.njit(nogil=nogil, **options)
    return decorate if function is None else decorate(function)


def _as_part(options: dict[str, Any], function: Callable[..., Any]) -> Callable[..., Any]:
    """Make a function known to the compiler for calls from compiled functions, and return it uncompiled."""
    extending: Any = importlib.import_module("numba.extending")

    def implementation(*_: Any) -> Callable[..., Any]:
        return function

    extending.overload(function, jit_options=options, strict=False)(implementation)
    return function


def keep_compiled_code() -> Path | None:
    """Set numba's cache directory to the directory of this version, unless NUMBA_CACHE_DIR is set.

    The function must be called before a module with compiled functions is imported. It hashes the sources (25 ms).

    Returns:
        The directory. If the user's cache directory is not writable, this is a temporary directory of this process.
        None if NUMBA_CACHE_DIR is set.
    """
    if os.environ.get("NUMBA_CACHE_DIR"):
        return None
    place = _user_cache() / "pendulum-balancer-rig" / f"{_KEPT}{source_digest()}"
    try:
        place.mkdir(parents=True, exist_ok=True)
        os.utime(place)
        tempfile.TemporaryFile(dir=place).close()
        _remove_unused(place)
    except (OSError, RuntimeError) as error:  # RuntimeError: the user has no home directory
        _log.info("compiled code is not kept for the next start, %s cannot be used: %s", place, error)
        place = Path(tempfile.mkdtemp(prefix="pendulum-balancer-rig-"))
        atexit.register(shutil.rmtree, place, ignore_errors=True)
    os.environ["NUMBA_CACHE_DIR"] = str(place)  # also for child processes
    if "numba" in sys.modules:
        sys.modules["numba"].config.CACHE_DIR = str(place)
    return place


def keeps_code(place: Path) -> bool:
    """Whether a directory of `keep_compiled_code` outlives this process."""
    return place.name.startswith(_KEPT)


def load_compiler() -> None:
    """Import the parts of numba that run compiled code, without scipy's linear algebra.

    On import, numba checks whether scipy has a BLAS. That check loads scipy.linalg, which takes 0.15 s. scipy is a
    dependency, so the check always succeeds and is skipped; numba's check of the integer width is kept. Compiled code
    that calls LAPACK loads it at the first call.
    """
    if "numba.np.arraymath" in sys.modules or "scipy.linalg" in sys.modules:
        return
    linalg: Any = importlib.import_module("numba.np.linalg")
    original = linalg.ensure_blas
    linalg.ensure_blas = getattr(linalg, "_check_lapack_int_width", lambda: None)
    try:
        importlib.import_module("numba.np.arraymath")
    finally:
        linalg.ensure_blas = original


def source_digest(root: Path = _ROOT) -> str:
    """Return sixteen hexadecimal digits that depend on all that compiled code is made of and on what compiles it.

    Args:
        root: directory that contains the packages of the project.
    """
    found = hashlib.sha256(sys.version.encode())
    for package, file in _COMPILER.items():
        spec = PathFinder.find_spec(package)  # imports nothing
        if spec is not None and spec.origin is not None:
            found.update(Path(spec.origin).with_name(file).read_bytes())
    for name in sorted(os.environ):
        if name.startswith("NUMBA_") and name not in _NOT_OPTIONS:
            found.update(f"\0{name}={os.environ[name]}".encode(errors="surrogateescape"))
    for name, text in compiled_sources(root).items():
        found.update(b"\0%s\0%d\0" % (name.encode(), len(text)) + text)
    return found.hexdigest()[:16]


def _user_cache() -> Path:
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA") or Path.home() / "AppData" / "Local")
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Caches"
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")


def _remove_unused(current: Path) -> None:
    for other in current.parent.glob(f"{_KEPT}*"):
        if other != current and time.time() - other.stat().st_mtime > _MAX_UNUSED_S:
            shutil.rmtree(other, ignore_errors=True)
