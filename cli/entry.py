"""Where the `rig` command begins: Ctrl-C while it is still loading ends it like any other."""

from __future__ import annotations

import sys


def main() -> None:
    """Entry point."""
    try:
        from cli.main import main as carry_out  # noqa: PLC0415 (loading takes a while)

        carry_out()
    except KeyboardInterrupt:
        print("rig: interrupted", file=sys.stderr)
        sys.exit(130)
