"""The `rig` command: parse, call one verb, print.

Exit codes: 0 done, 1 a verdict of "fail", 2 bad use or bad input, 3 hardware or I/O fault, 70 an unexpected error,
130 interrupted, 141 the reader of standard output is gone.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Collection, Sequence
from contextlib import nullcontext
from errno import EDQUOT, EFBIG, ENOSPC, EPIPE
from keyword import iskeyword

from cyclopts import App, CycloptsError

from daq.errors import AcquisitionError, LogError, OperatorStop
from dynamics.compiled_code import keep_compiled_code
from live.errors import LiveError
from reproduction.errors import ReproductionError, UnknownItem
from rig_basics.errors import RigError
from rig_basics.log_output import show_log
from rig_cli import answer, crash
from rig_cli.console import notify, wait_for_compilation
from rig_cli.misused import error_panel, error_words
from rig_cli.numbers import NUMBERS_ARE_FINITE
from rig_cli.signals import end_at_next_signal, interrupt_at_signals
from rig_cli.streams import OutputLost, discard_results, open_streams
from studies.errors import EngineMissing, OtherSoftware, StudyError, StudyInputError

_VERBS = {  # modules are imported when their verb is called: `rig --help` and `rig predict` start without the drivers
    "rig_cli.demo": {
        "demo": "A whole campaign on the virtual rig: tests recorded through the real drivers, identified, validated, "
        "reported.",
    },
    "rig_cli.acquire": {
        "check": "Validate a rig file, open its devices, compare them with the file; exit 3 when a device fails a "
        "check.",
        "record": "Record every device until Ctrl-C, for --duration, or until all are silent; shows rates, losses and "
        "the disk.",
    },
    "rig_cli.calibrate": {
        "calibrate": "Calibrate a laser against gauge blocks or a micrometer, or the encoders at their locks; exit 1 "
        "when refused.",
    },
    "rig_cli.devices": {
        "devices": "List ports and the devices on them, with tables to paste into a rig file; without --ask no byte is "
        "sent.",
    },
    "rig_cli.guided_test": {
        "test": "Run one guided test, or show its plan; without a name, list what the rig can do and what is missing.",
    },
    "rig_cli.offline": {
        "identify": "Identify k1, k2, ζ1, ζ2, c3, c4, S_P with covariance from logs; writes parameters.toml.",
        "validate": "Compare steady states and releases at points with the model; exit 1 when a point does not pass.",
    },
    "rig_cli.report": {
        "report": "Write the report of a campaign's logs, at any time; exit 1 when a point fails.",
    },
    "rig_cli.track": {"track": "States and pendulum damping of a logged run over time, with uncertainty."},
    "rig_cli.plot": {
        "plot": "Draw logs: orbit, Bode, polar, waterfall and more, the model with what was measured.",
    },
    "rig_cli.logs": {
        "log": "What is in one log, and whether it is whole: every byte is checked; exit 1 when the file is cut or "
        "damaged.",
        "logs": "List the logs of a folder and of the folders below it, newest first.",
    },
    "rig_cli.replay": {"replay": "Decode a log's raw bytes again through the same pipelines."},
    "rig_cli.live": {"live": "Show a rig or a log in the browser, with a stop button; access needs its token."},
    "rig_cli.recover": {
        "recover": "Make a cut or damaged log whole: a new file of its intact part; lists what is missing.",
    },
    "rig_cli.exchange": {
        "export": "Write a log's channels for other programs: parquet, csv, MATLAB/Octave, hdf5.",
        "import": "Make a log of a csv, parquet, mat or hdf5 file recorded elsewhere.",
    },
    "rig_cli.model": {
        "predict": "Steady states, stability and amplitudes at a point or a speed, and where a release ends.",
    },
    "rig_cli.react": {
        "react": "How the pendulums answer a sudden change at speed: vibration, peak, and the time until it is "
        "balanced again.",
    },
    "rig_cli.basins": {"basins": "Where releases end, over the angles at which the locks hold the pendulums."},
    "rig_cli.maps": {"map": "Where the balanced state is stable, over any two numbers of the rig file."},
    "rig_cli.plan": {
        "plan": "List the experiments that reach a wanted uncertainty: duration, amplitude, sample rate; exit 1 when "
        "none can.",
    },
    "rig_cli.completion": {
        "completion": "Print the script with which a shell completes commands and options of rig.",
    },
    "rig_cli.reproduce": {
        "reproduce": "Reproduce figures and tables of the source and judge its claims.",
    },
    "rig_cli.bench": {"bench": "Time against true error for every method on offer, with peers in the same run."},
}
_FULL = (ENOSPC, EDQUOT, EFBIG)  # disk full, quota of the user exceeded, file larger than the file system allows
_PARAMETERS = "Show identified parameters, compare them, follow them over time."
_DRIVER = "List the installed drivers, check one against what every driver must do."
_LOG_LEVEL = "--log-level"
_STUDY = "Run whole campaigns by the hundred, or identify an archive again; on one machine or many."
_VIRTUAL = "Start a virtual rig; operate it from another terminal."
_USE_COMPILED = {
    "check",
    "devices",
    "record",
    "test",
    "calibrate",
    "log",
    "replay",
    "recover",
    "export",
    "import",
    "live",
    "identify",
    "track",
    "plot",
    "validate",
    "report",
    "driver",
}


def commands(loaded: Collection[str] = ()) -> App:
    """Return the command line.

    Args:
        loaded: verbs whose modules are imported for their full help. The help of the others is the line given here.
    """
    app = App(
        name="rig",
        suppress_keyboard_interrupt=False,
        default_parameter=NUMBERS_ARE_FINITE,
        version=_version,
        help="Runs a pendulum-balancer rotor rig: acquisition, identification, validation, report.\n\n"
        "Every command takes --log-level LEVEL (debug, info, warning or error): lines about what the software does and "
        "which errors it ignores, on standard error.",
    )
    for module, verbs in _VERBS.items():
        for verb, line in verbs.items():
            place = f"{module}:{verb}{'_' if iskeyword(verb) else ''}"
            app.command(place, name=verb, help=None if verb in loaded else line)
    app.command("rig_cli.parameters:app", name="parameters", help=None if "parameters" in loaded else _PARAMETERS)
    app.command("rig_cli.virtual:app", name="virtual", help=None if "virtual" in loaded else _VIRTUAL)
    app.command("rig_cli.studies:app", name="study", help=None if "study" in loaded else _STUDY)
    app.command("rig_cli.drivers:app", name="driver", help=None if "driver" in loaded else _DRIVER)
    return app


def _version() -> str:
    from daq.version import software_version  # importlib.metadata takes 15 ms

    return software_version()


def run(arguments: list[str]) -> int:
    """Carry out one command and return the exit code, also if what it prints cannot be written."""
    answer.begin(arguments)
    try:
        code = _answered(arguments)
        sys.stdout.flush()
    except OutputLost as error:
        discard_results()
        if error.errno == EPIPE:  # usual: the program that read the output, for example `head`, has closed it
            return 141
        notify(f"rig: {error.strerror}")
        return 3
    return code


def _answered(arguments: list[str]) -> int:
    try:
        _check_threads(os.environ.get("NUMBA_NUM_THREADS", "1"))
        rest, level = split_log_level(arguments)
        if level is not None:
            show_log(level)
    except RigError as error:
        notify(f"rig: {error}")
        answer.give_error(str(error), 2)
        return answer.ended(2)
    return answer.ended(_carried_out(rest))


class UnusableVariable(RigError, ValueError):
    """A variable of the environment has a value with which nothing can be computed."""


def _check_threads(number: str) -> None:
    if not number.strip().isdecimal() or int(number[:9]) < 1:
        raise UnusableVariable(
            f"environment variable NUMBA_NUM_THREADS: expected a number of threads, 1 or more, got {number[:40]!r}; "
            "unset it"
        )


def split_log_level(arguments: Sequence[str]) -> tuple[list[str], str | None]:
    """Return the command line without `--log-level LEVEL`, and the level.

    Raises:
        UnknownLevel: no level follows.
    """
    rest, level = list[str](), None
    words = iter(arguments)
    for word in words:
        if word == "--":
            return [*rest, word, *words], level
        if word == _LOG_LEVEL:
            level = next(words, "")
        elif word.startswith(f"{_LOG_LEVEL}="):
            level = word.removeprefix(f"{_LOG_LEVEL}=")
        else:
            rest.append(word)
    return rest, level


def _carried_out(arguments: list[str]) -> int:
    try:
        with wait_for_compilation("log") if set(arguments[:1]) & _USE_COMPILED else nullcontext():
            result = commands(arguments)(
                arguments,
                exit_on_error=False,
                print_error=True,
                error_formatter=error_panel,
                result_action="return_value",
            )
        return result if isinstance(result, int) else 0
    except CycloptsError as error:
        answer.give_error(" ".join(error_words(error).split()), 2)  # cyclopts has printed the same on standard error
        return 2
    except OutputLost:
        raise
    except KeyboardInterrupt as stop:
        text = f"interrupted{f' by {stop}' if str(stop) else ''}"
        notify(f"rig: {text}")
        answer.give_error(text, 130)
        return 130
    except Exception as error:
        code = _exit_code(error)
        if code is None:
            crash.report(error, arguments)
            return answer.ended(0)
        notify(f"rig: {_words(error)}")
        answer.give_error(_words(error), code)
        return code


def _words(error: Exception) -> str:
    """Return the text of an error, with what to do if the error itself does not contain it."""
    if isinstance(error, MemoryError):
        return f"the memory is full{f' ({error})' if str(error) else ''}; end other programs, or use a part of the data"
    full = isinstance(error, OSError) and error.errno in _FULL
    return f"{error}{'; make room on the disk, or use another' if full else ''}"


def _exit_code(error: Exception) -> int | None:
    """Return 2 for bad input, 3 for hardware, I/O and memory errors, None for an unexpected error."""
    if isinstance(error, OperatorStop):
        return 130
    hardware = isinstance(error, AcquisitionError | LiveError) and not isinstance(error, LogError)
    study = isinstance(error, StudyError) and not isinstance(error, StudyInputError | EngineMissing | OtherSoftware)
    unfinished = isinstance(error, ReproductionError) and not isinstance(error, UnknownItem)
    if hardware or study or unfinished:
        return 3
    if isinstance(error, RigError):
        return 2
    return 3 if isinstance(error, OSError | MemoryError) else None


def main() -> None:
    """Carry out the command of the command line and end the program with its exit code."""
    keep_compiled_code()  # set the folder of compiled code before anything compiles; child processes inherit it
    interrupt_at_signals()
    crash.watch_threads(sys.argv[1:])
    code = run(sys.argv[1:])
    end_at_next_signal(code)
    sys.exit(code)


if __name__ == "__main__":
    open_streams()
    main()
