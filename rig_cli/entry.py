"""Entry point of the `rig` command. Ctrl-C and errors during loading are reported as those of a running command."""

from __future__ import annotations

import gc
import sys

from rig_cli.signals import end_at_next_signal
from rig_cli.stages import begin_stage, watch_stages
from rig_cli.streams import open_streams

_SHORT_COMMANDS = {"predict", "--help", "-h", "--version"}  # commands that end within a second or two
_RARE_COLLECTION = (100_000, 50, 50)  # loading creates hundreds of thousands of objects and hardly any garbage


def main() -> None:
    """Entry point."""
    if set(sys.argv[1:2]) & _SHORT_COMMANDS:  # long-running commands keep the default, which gives shorter pauses
        gc.set_threshold(*_RARE_COLLECTION)
    open_streams()
    watch_stages(sys.argv[1:])
    try:
        from rig_cli.main import main as carry_out  # loading takes a while

        carry_out()
    except KeyboardInterrupt:  # usual: reported
        end_at_next_signal(130)
        from rig_cli import answer  # needed by no command that works

        print("rig: interrupted", file=sys.stderr)
        answer.begin(sys.argv[1:])
        answer.give_error("interrupted", 130)
        sys.exit(130)
    except Exception as error:
        from rig_cli import answer, crash  # needed by no command that works

        answer.begin(sys.argv[1:])
        crash.report(error, sys.argv[1:])
        sys.exit(answer.ended(0))
    finally:
        begin_stage("")
        gc.freeze()  # at exit the interpreter would search all objects of numba for garbage: a third of a second


if __name__ == "__main__":
    main()
