"""Where the `rig` command begins: Ctrl-C while it is still loading ends it like any other, and so does any fault."""

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
    except Exception as error:
        from cli.crash import report  # noqa: PLC0415 (needed by no command that works)

        sys.exit(report(error, sys.argv[1:]))
