"""Acquisition: devices, their protocols, logs, guided tests, replay, the catalogue, the virtual rig.

Public here: logs and their signals. `daq.exchange` reads and writes files of other programs, `daq.replay` decodes raw
bytes again, `daq.lockstep.Rehearsal` records guided tests on the virtual rig.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from daq.log import Log, open_log
    from daq.log.recover import recover
    from daq.signals.run import Run, load_run

_HOME = {  # loaded when first used: numba, only when a log is opened
    "Log": "daq.log",
    "Run": "daq.signals.run",
    "load_run": "daq.signals.run",
    "open_log": "daq.log",
    "recover": "daq.log.recover",
}

__all__ = ["Log", "Run", "load_run", "open_log", "recover"]


def __getattr__(name: str) -> Any:
    """A public name from its room."""
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(_HOME[name]), name)
