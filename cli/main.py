"""The `rig` command: parse, call one verb, print.

Exit codes: 0 done, 1 a verdict of "fail", 2 bad use or bad input, 3 hardware or I/O fault, 130 interrupted.
"""

from __future__ import annotations

import sys
from contextlib import nullcontext
from keyword import iskeyword

from cyclopts import App, CycloptsError

from analysis.errors import AnalysisError
from cli.console import say, wait_for_compilation
from daq.errors import LogError, RigError
from dynamics.errors import DynamicsError
from rig_configs.errors import RigConfigError

app = App(name="rig", help="Runs a pendulum-balancer rotor rig: acquisition, identification, validation, report.")
_VERBS = {  # imported when called: `rig predict` need not wait for the drivers
    "cli.demo": ("demo",),
    "cli.acquire": ("virtual", "check", "record", "test"),
    "cli.offline": ("identify", "validate"),
    "cli.logs": ("log", "logs"),
    "cli.replay": ("replay",),
    "cli.recover": ("recover",),
    "cli.exchange": ("export", "import"),
    "cli.model": ("predict", "map"),
    "cli.bench": ("bench",),
}
_USE_COMPILED = {"check", "record", "test", "log", "replay", "recover", "export", "import", "identify", "validate"}
for module, verbs in _VERBS.items():
    for verb in verbs:
        app.command(f"{module}:{verb}{'_' if iskeyword(verb) else ''}", name=verb)


def run(arguments: list[str]) -> int:
    """Carry out one command; returns the exit code."""
    try:
        with wait_for_compilation("log") if set(arguments[:1]) & _USE_COMPILED else nullcontext():
            result = app(arguments, exit_on_error=False, print_error=True, result_action="return_value")
        return result if isinstance(result, int) else 0
    except CycloptsError:
        return 2  # cyclopts has said what is wrong
    except (RigConfigError, DynamicsError, LogError, AnalysisError) as error:
        say(f"rig: {error}")
        return 2
    except RigError as error:
        say(f"rig: {error}")
        return 3
    except OSError as error:
        say(f"rig: {error}")
        return 3
    except KeyboardInterrupt:
        say("rig: interrupted")
        return 130


def main() -> None:
    """Entry point."""
    sys.exit(run(sys.argv[1:]))


if __name__ == "__main__":
    main()
