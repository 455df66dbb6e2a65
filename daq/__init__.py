"""Acquisition: devices, their protocols, logs, guided tests, replay, the catalogue, the virtual rig."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from daq.log import Log, open_log

__all__ = ["Log", "open_log"]


def __getattr__(name: str) -> Any:
    """Loaded when asked for: drivers need no reader, and the reader takes a third of a second."""
    if name in __all__:
        from daq import log  # noqa: PLC0415

        return getattr(log, name)
    raise AttributeError(f"module 'daq' has no attribute {name!r}")
