"""Where the `rig` command begins: Ctrl-C while it is still loading ends it like any other, and so does any fault."""

from __future__ import annotations

import gc
import sys

_AT_ONCE = {"predict"}  # commands that end within a second or two
_SELDOM = (100_000, 50, 50)  # loading makes hundreds of thousands of objects and hardly any garbage


def main() -> None:
    """Entry point."""
    if set(sys.argv[1:2]) & _AT_ONCE:  # a process that lives long wants short pauses instead
        gc.set_threshold(*_SELDOM)
    try:
        from rig_cli.main import main as carry_out  # noqa: PLC0415 (loading takes a while)

        carry_out()
    except KeyboardInterrupt:
        from rig_cli import answer  # noqa: PLC0415 (needed by no command that works)

        print("rig: interrupted", file=sys.stderr)
        answer.begin(sys.argv[1:])
        answer.give_error("interrupted", 130)
        sys.exit(130)
    except Exception as error:
        from rig_cli import answer, crash  # noqa: PLC0415 (needed by no command that works)

        answer.begin(sys.argv[1:])
        crash.report(error, sys.argv[1:])
        sys.exit(answer.ended(0))
    finally:
        gc.freeze()  # else the interpreter, before it ends, looks for garbage in all of numba: a third of a second


if __name__ == "__main__":
    main()
