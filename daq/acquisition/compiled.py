"""Compilation of everything that an acquisition runs, before a device is opened.

The first use on a computer, and the first one after an update, compiles for seconds. Compiled later, a heartbeat of the
host would be late, and the drive would be blamed.
"""

from __future__ import annotations

from daq.acquisition.exceedance import compile_look
from daq.signals.normal_equations import compile_solve


def compile_acquisition() -> None:
    """Compile, or load from the cache, the loops of interlocks and looks of guided tests."""
    compile_look()
    compile_solve()
