"""Which software made a file."""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError, version


def software_version() -> str:
    """Version of the installed package."""
    try:
        return version("pendulum-balancer-rig")
    except PackageNotFoundError:
        return "unknown"
