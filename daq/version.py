"""Version of the software and of its decoders, which are written into every log."""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError, version

DECODER = 1
"""Number of the decoders, a fact of every log. It is to be raised by one whenever the same bytes give other samples,
events or times than before, by a change of a pipeline or of a clock's map."""


def software_version() -> str:
    """Return the version of the installed package, or "unknown" if it is not installed."""
    try:
        return version("pendulum-balancer-rig")
    except PackageNotFoundError:  # usual: run from a folder of the source
        return "unknown"
