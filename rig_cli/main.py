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

from cyclopts import App, CycloptsError, Group

from daq.errors import AcquisitionError, LogError, OperatorStop
from dynamics.compiled_code import keep_compiled_code
from live.errors import LiveError
from reproduction.errors import ReproductionError, UnknownItem
from rig_basics.errors import RigError
from rig_basics.log_output import show_log
from rig_cli import answer, crash
from rig_cli.command_groups import GROUPS
from rig_cli.console import notify, wait_for_compilation
from rig_cli.first_start import compile_in_background
from rig_cli.misused import error_panel, error_words
from rig_cli.numbers import EVERY_OPTION
from rig_cli.signals import dropped, end_at_next_signal, end_without_threads, ignore_unfinished, interrupt_at_signals
from rig_cli.streams import OutputLost, discard_results, open_streams
from studies.errors import EngineMissing, OtherSoftware, StudyError, StudyInputError

_FULL = (ENOSPC, EDQUOT, EFBIG)  # disk full, quota of the user exceeded, file larger than the file system allows
_INTERRUPTED = 130
_LOG_LEVEL = "--log-level"
_OPENS_NO_RIG = {"predict", "plan", "identify", "validate"}
_ONLY_SHOWN = {"--help", "-h", "--version"}
_THIS_PROGRAM = Group("This program", sort_key=len(GROUPS))
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
        loaded: commands whose modules are imported for their full help. The help of the others is their sentence.
    """
    app = App(
        name="rig",
        suppress_keyboard_interrupt=False,
        default_parameter=EVERY_OPTION,
        version=_version,
        version_format="plaintext",
        help_format="plaintext" if _ONLY_SHOWN.issuperset(loaded) else "markdown",  # Markdown takes 25 ms to import
        help="Runs a pendulum-balancer rotor rig: acquisition, identification, validation, report.\n\n"
        "Every command takes --log-level LEVEL (debug, info, warning or error): lines about what the software does and "
        "which errors it ignores, on standard error.",
    )
    for number, (title, group) in enumerate(GROUPS.items()):
        panel = Group(title, sort_key=number)
        for place, (name, command) in enumerate(group.items()):
            line = command.own_help if name in loaded else command.sentence  # a command is imported when it is called
            app.command(command.place, name=name, help=line, group=panel, sort_key=place)
    for flag in ("--help", "--version"):
        app[flag].group = (_THIS_PROGRAM,)
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
        others, level = split_log_level(arguments)
        if level is not None:
            show_log(level)
    except RigError as error:
        notify(f"rig: {error}")
        answer.give_error(str(error), 2)
        return answer.ended(2)
    return answer.ended(_carried_out(others))


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
    others, level = list[str](), None
    words = iter(arguments)
    for word in words:
        if word == "--":
            return [*others, word, *words], level
        if word == _LOG_LEVEL:
            level = next(words, "")
        elif word.startswith(f"{_LOG_LEVEL}="):
            level = word.removeprefix(f"{_LOG_LEVEL}=")
        else:
            others.append(word)
    return others, level


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
        return _interrupted(str(stop))
    except Exception as error:
        code = _exit_code(error)
        if code is None and dropped:
            return _interrupted(dropped[-1])
        if code is None:
            crash.report(error, arguments)
            return answer.ended(0)
        notify(f"rig: {_words(error)}")
        answer.give_error(_words(error), code)
        return code


def _interrupted(by: str) -> int:
    ignore_unfinished()
    text = f"interrupted{f' by {by}' if by else ''}"
    notify(f"rig: {text}")
    answer.give_error(text, _INTERRUPTED)
    return _INTERRUPTED


def _words(error: Exception) -> str:
    """Return the text of an error, with what to do if the error itself does not contain it."""
    if isinstance(error, MemoryError):
        return f"the memory is full{f' ({error})' if str(error) else ''}; end other programs, or use a part of the data"
    full = isinstance(error, OSError) and error.errno in _FULL
    return f"{error}{'; make room on the disk, or use another' if full else ''}"


def _exit_code(error: Exception) -> int | None:
    """Return 2 for bad input, 3 for hardware, I/O and memory errors, None for an unexpected error."""
    if isinstance(error, OperatorStop):
        return _INTERRUPTED
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
    if not _ONLY_SHOWN & set(sys.argv[1:2]):  # the folder takes 25 ms to name, and nothing compiles
        place = keep_compiled_code()  # before anything compiles; child processes inherit it
        if _OPENS_NO_RIG & set(sys.argv[1:2]) and compile_in_background(place):  # a rotor that turns has no other load
            notify(
                "rig: compiling in the background, once after an installation: minutes, in which commands wait longer"
            )
    interrupt_at_signals()
    crash.watch_threads(sys.argv[1:])
    code = run(sys.argv[1:])
    end_at_next_signal(code)
    if code == _INTERRUPTED:
        end_without_threads(code)
    sys.exit(code)


if __name__ == "__main__":
    open_streams()
    main()
