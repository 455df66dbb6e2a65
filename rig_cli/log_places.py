"""The logs that a command takes: files, and the logs of folders."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from daq.errors import LogError
from rig_basics.texts import number_of
from rig_cli.console import notify
from rig_cli.stages import begin_stage
from rig_configs import RigFileError

if TYPE_CHECKING:
    from daq.log.time_span import TimeSpan
    from daq.signals.run import Run


@dataclass(frozen=True)
class LogPlaces:
    """Logs of a command line.

    Attributes:
        logs: all logs, each once, in the order of the command line; those of a folder sorted by name.
        of_folders: those of them that are in a folder and were not named themselves.
    """

    logs: tuple[Path, ...]
    of_folders: frozenset[Path] = frozenset()


def logs_of(command: str, places: Sequence[Path], usage: str = "LOG|FOLDER…") -> LogPlaces:
    """Return the logs given by name, and those in the given folders or one level below.

    Verdict files, which a pattern such as out/* matches as well, are left out.

    Args:
        command: for example "rig identify", for messages.
        places: logs and folders.
        usage: arguments of the command, for messages.
    Raises:
        RigFileError: no log is given, a folder has no logs, or a place does not exist.
    """
    from daq.log.verdicts import without_verdicts  # pydantic takes a while to import

    logs, of_folders = dict[Path, None](), set[Path]()
    for place in without_verdicts(places):
        if not place.is_dir():
            if not place.exists():
                raise RigFileError(f"{command}: {place}: expected a folder or a log, found no file of this name")
            logs[place] = None
            of_folders.discard(place)
            continue
        found = sorted([*place.glob("*.mcap"), *place.glob("*/*.mcap")])
        if not found:
            raise RigFileError(f"{command}: {place}: expected logs (*.mcap) in this folder, found none")
        of_folders.update(log for log in found if log not in logs)
        logs.update(dict.fromkeys(found))
    if not logs:
        raise RigFileError(f"no log given; usage: {command} {usage}")
    return LogPlaces(tuple(logs), frozenset(of_folders))


def readable_runs(places: LogPlaces, part: TimeSpan | None = None) -> tuple[list[Run], list[str]]:
    """Load all runs; return also a message for each log of a folder that cannot be read.

    Raises:
        LogError: a log given by name cannot be read, or no log can be.
    """
    from studies.runs import WHOLE, load_runs  # numba takes seconds to import

    begin_stage(f"reading {number_of(len(places.logs), 'log')}")
    runs: list[Run] = []
    messages: list[str] = []
    for log in places.logs:
        try:
            runs += load_runs([log], part or WHOLE)
        except LogError as error:
            if log not in places.of_folders or len(places.logs) == 1:
                raise
            messages.append(f"not used: {error}")
    if not runs:
        raise LogError(f"no log of {len(places.logs)} can be read; the first: {messages[0]}")
    for text in messages:
        notify(f"warning: {text}")
    return runs, messages
