"""Logs: written (`file`), opened (`opened`), made whole (`recover`), and what they say of themselves.

Loaded when asked for: who writes a log needs no reader, and the reader takes a third of a second to load.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from daq.log.opened import Log, open_log

__all__ = ["Log", "open_log"]


def __getattr__(name: str) -> Any:
    if name in __all__:
        from daq.log import opened  # noqa: PLC0415

        return getattr(opened, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
