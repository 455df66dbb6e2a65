"""Options that several commands share."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from rig_cli.console import say
from rig_configs import RigFileError, load_rig
from rig_configs.load import apply_setting, parse_setting, validate
from rig_configs.schema import Rig

Settings = Annotated[
    list[str] | None,
    Parameter(name="--set", help="key=value laid over the rig file, e.g. suspension.zeta2=0.05; *1.05 and +5% too"),
]
Json = Annotated[bool, Parameter(name="--json", negative="", help="one JSON object on standard output")]
ParametersPath = Annotated[Path | None, Parameter(name="--parameters", help="parameters.toml laid over the rig file")]


def rig_or_log(source: str, settings: Sequence[str]) -> tuple[Rig, dict[str, Any]]:
    """A rig by file, by name, or as a log's snapshot of it; with a log, its devices' identities too.

    Raises:
        RigFileError, LogError: neither.
    """
    if not source.endswith((".mcap", ".mcap.part")):
        return load_rig(source, settings=settings), {}
    from daq.log import open_log  # noqa: PLC0415 (numba takes a third of a second to import)
    from daq.log.snapshot import identities_of, snapshot_of  # noqa: PLC0415
    from daq.replay.stream import pipelines_with  # noqa: PLC0415

    with open_log(source) as log:
        raw, identities = snapshot_of(log), identities_of(log)
    for text in settings:
        apply_setting(raw, *parse_setting(text), source)
    rig = validate(raw, source)
    pipelines_with(rig, identities, source)  # says what cannot be, before a file is made
    return rig, identities


def warn_of_slips(rig: Rig) -> list[str]:
    """Say which numbers and ports of a rig file are likely slips, before a device is opened by them."""
    from rig_configs.usual_numbers import doubts  # noqa: PLC0415 (only where devices are opened)

    found = doubts(rig)
    for text in found:
        say(f"warning: {text}")
    return found


def what_if_words(settings: Sequence[str] | None, before: str = "") -> str:
    """ "what if suspension.zeta2=0.05", with something before it; empty without settings."""
    return f"{before}what if {', '.join(settings)}" if settings else ""


def need_place(option: str, *paths: Path | None) -> None:
    """Whether files can be written there, asked before the work is done.

    Args:
        option: where they were named, for messages.
        paths: the files; None: none is wanted.
    Raises:
        RigFileError: a folder is not there, or the name is a folder's.
    """
    for path in paths:
        if path is not None and not path.parent.is_dir():
            raise RigFileError(f"{option} {path}: there is no folder {path.parent}; make it, or give another name")
        if path is not None and path.is_dir():
            raise RigFileError(f"{option} {path}: expected a file's name, this is a folder; give another name")
