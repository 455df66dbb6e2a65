"""Logs: writing (`file`), reading (`opened`), recovery (`recover`), and the facts they contain.

The reader is imported at its first use: it takes a third of a second to load, and a program that writes logs does not
need it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from daq.log.opened import Log, open_log

__all__ = ["Log", "open_log"]


def __getattr__(name: str) -> Any:
    if name in __all__:
        from daq.log import opened  # noqa: PLC0415 (a third of a second, only for readers)

        return getattr(opened, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
