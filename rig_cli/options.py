"""Options that several commands share."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from rig_cli.console import notify
from rig_cli.option_groups import LOG_PART, OUTPUT, RIG_NUMBERS
from rig_configs import IdentifiedParameters, RigFileError, load_rig
from rig_configs.load import apply_setting, parse_setting, set_by, validate
from rig_configs.parameters_file import filled_remarks
from rig_configs.schema import Rig

RigFile = Annotated[str, Parameter(help="a rig file, or the name of a shipped rig")]
Settings = Annotated[
    list[str] | None,
    Parameter(
        name="--set",
        group=RIG_NUMBERS,
        help="key=value over the rig file, e.g. suspension.zeta2=0.05; *1.05 and +5% too",
    ),
]
Json = Annotated[bool, Parameter(name="--json", group=OUTPUT, negative="", help="one JSON object on standard output")]
Force = Annotated[
    bool, Parameter(name="--force", group=OUTPUT, negative="", help="replace existing files of these names")
]
ParametersPath = Annotated[
    Path | None, Parameter(name="--parameters", group=RIG_NUMBERS, help="parameters.toml over the rig file")
]


@Parameter(name="*", group=LOG_PART)
@dataclass(frozen=True)
class LogSpan:
    """Part of a log.

    Attributes:
        from_s: first instant, seconds since the log's start
        to_s: end, seconds since the log's start
    """

    from_s: Annotated[float | None, Parameter(name="--from")] = None
    to_s: Annotated[float | None, Parameter(name="--to")] = None


WHOLE_LOG = LogSpan()


def load_rig_or_log(source: str, settings: Sequence[str]) -> tuple[Rig, dict[str, Any]]:
    """Load a rig by file, by name, or from a log's snapshot; from a log also the identities of its devices.

    Raises:
        RigFileError, LogError: the rig file or the log cannot be read.
    """
    if not source.endswith((".mcap", ".mcap.part")):
        return load_rig(source, settings=settings), {}
    from daq.log import open_log  # numba takes a third of a second to import
    from daq.log.snapshot import identities_of, snapshot_of
    from daq.replay.stream import pipelines_with

    with open_log(source) as log:
        raw, identities = snapshot_of(log), identities_of(log)
    for text in settings:
        apply_setting(raw, *parse_setting(text), source)
    rig = validate(raw, source)
    pipelines_with(rig, identities, source)  # raises for what cannot be decoded, before a file is created
    return rig, identities


def warn_of_unusual_settings(rig: Rig) -> list[str]:
    """Report numbers and ports of a rig file that are likely mistakes, before a device is opened."""
    from rig_configs.usual_numbers import doubts  # only if devices are opened

    found = doubts(rig)
    for text in found:
        notify(f"warning: {text}")
    return found


def warn_of_filled(known: IdentifiedParameters | None, rig: Rig, settings: Sequence[str] | None) -> None:
    """Report the values that given parameters lack, and that are those of the rig file.

    Args:
        known: given parameters; None or empty if there are none, where all values are the rig file's.
        rig: rig with the parameters.
        settings: settings of the command; a value that they set is not reported.
    """
    if known is not None and known.values:
        chosen, missing = set_by(settings or []), known.missing(rig.physics)
        for text in filled_remarks({name: found for name, found in missing.items() if name not in chosen}):
            notify(f"warning: {text}")


def what_if_words(settings: Sequence[str] | None, before: str = "") -> str:
    """Return for example "what if suspension.zeta2=0.05" after the prefix `before`; empty without settings."""
    return f"{before}what if {', '.join(settings)}" if settings else ""


def check_outputs(option: str, *paths: Path | None, force: bool) -> None:
    """Check that output files can be written, before the work is done.

    Args:
        option: option of the files, for messages.
        paths: output files; None for one that was not requested.
        force: whether existing files may be replaced.
    Raises:
        RigFileError: the folder does not exist, the name is that of a folder, or the file exists.
    """
    for path in paths:
        if path is not None and not path.parent.is_dir():
            raise RigFileError(
                f"{option} {path}: the folder {path.parent} does not exist; make it, or give another name"
            )
        if path is not None and path.is_dir():
            raise RigFileError(f"{option} {path}: expected a file's name, this is a folder; give another name")
        if path is not None and path.is_file() and not force:
            raise RigFileError(f"{option} {path}: the file exists; give --force to replace it, or another name")
