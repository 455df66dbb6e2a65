"""Software version that is written into every file."""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError, version


def software_version() -> str:
    """Return the version of the installed package, or "unknown" if it is not installed."""
    try:
        return version("pendulum-balancer-rig")
    except PackageNotFoundError:  # usual: run from a folder of the source
        return "unknown"
