"""Public names of `daq.log`; each is imported at its first use."""

from .opened import (
    Log as Log,
    open_log as open_log,
)
