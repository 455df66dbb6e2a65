"""Acquisition: devices, their protocols, logs, guided tests, replay, the catalogue, the virtual rig."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from daq.log import Log, open_log

__all__ = ["Log", "open_log"]


def __getattr__(name: str) -> Any:
    if name in __all__:
        from daq import log  # noqa: PLC0415 (numba, only when a log is opened)

        return getattr(log, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
