"""Acquisition: devices, their protocols, logs, guided tests, replay, the catalogue, the virtual rig.

Public here: an open rig, recordings, logs and their signals. `daq.exchange` reads and writes files of other programs,
`daq.replay` decodes raw bytes again, `daq.lockstep.Rehearsal` records guided tests on the virtual rig.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from daq.acquisition.session import Session
    from daq.log import Log, open_log
    from daq.log.recover import recover
    from daq.recording import open_rig, record
    from daq.signals.run import Run, load_run

_MODULE_OF = {  # imported at first use: numba is loaded only when a log is opened
    "Log": "daq.log",
    "Run": "daq.signals.run",
    "Session": "daq.acquisition.session",
    "load_run": "daq.signals.run",
    "open_log": "daq.log",
    "open_rig": "daq.recording",
    "record": "daq.recording",
    "recover": "daq.log.recover",
}

__all__ = ["Log", "Run", "Session", "load_run", "open_log", "open_rig", "record", "recover"]


def __getattr__(name: str) -> Any:
    """Import a public name from its module at first use."""
    if name not in _MODULE_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(_MODULE_OF[name]), name)


def __dir__() -> list[str]:
    """Return the public names, also those that are not loaded yet."""
    return sorted(__all__)
