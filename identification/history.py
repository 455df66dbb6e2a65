"""A rig's parameters over time, from its parameters files.

Each file is one instant: when its logs were recorded. What a file keeps of its tests gives each log's own values beside
the joint ones, so nothing is fitted again. A log enters the history by being identified: `rig identify LOG… -o FILE`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from itertools import pairwise
from pathlib import Path

from identification.compare import Comparison, compare, holm
from identification.errors import NotIdentifiable
from identification.joint.provenance import KeptTest, kept_tests
from rig_configs.errors import ParametersFileError
from rig_configs.parameters_file import IdentifiedParameters


@dataclass(frozen=True)
class Instant:
    """One parameters file.

    Attributes:
        path: the file.
        time: first recording of its logs; the file's own time where it does not say.
        time_known: whether it does.
        rig: the rig's name; "" when unknown.
        parameters: what it holds.
        tests: what it keeps of its tests; empty where it keeps nothing.
    """

    path: Path
    time: datetime
    time_known: bool
    rig: str
    parameters: IdentifiedParameters
    tests: list[KeptTest]


@dataclass(frozen=True)
class History:
    """A rig's parameters over time.

    Attributes:
        instants: by time.
        steps: each file against the one before it that shares a parameter, None for the first; p_holm counts every
            look of the whole history.
        skipped: TOML files found that hold no parameters, with why.
    """

    instants: list[Instant]
    steps: list[Comparison | None]
    skipped: list[str]


def history(paths: Sequence[Path], rig: str | None = None) -> History:
    """The history that parameters files tell.

    Args:
        paths: files, and folders in which every .toml with a covariance is one, those below included.
        rig: only files of this rig, where there are several.
    Raises:
        ParametersFileError: a file given by name is none, or the files are of several rigs and none was chosen.
        NotIdentifiable: there is no parameters file.
    """
    instants: list[Instant] = []
    skipped: list[str] = []
    for path in _files(paths):
        try:
            instants.append(_instant(path))
        except ParametersFileError as fault:
            if path in paths:
                raise
            skipped.append(str(fault))
    if not instants:
        raise NotIdentifiable(
            f"{', '.join(map(str, paths))}: no parameters file found; `rig identify LOG… -o FILE.toml` writes one"
        )
    rigs = sorted({i.rig for i in instants if i.rig})
    if rig is None and len(rigs) > 1:
        raise ParametersFileError(f"these files are of several rigs: {', '.join(rigs)}. Choose one with --rig NAME")
    chosen = [i for i in instants if rig is None or i.rig == rig]
    if not chosen:
        raise ParametersFileError(f"no file is of rig {rig!r}; found: {', '.join(rigs) or 'files that do not say'}")
    chosen.sort(key=lambda i: i.time)
    return History(chosen, _steps(chosen), skipped)


def _files(paths: Sequence[Path]) -> list[Path]:
    found: dict[Path, Path] = {}
    for path in paths:
        if path.suffix == ".mcap":
            raise ParametersFileError(
                f"{path}: a log has no parameters yet; `rig identify {path} -o FILE.toml` finds them; give FILE.toml"
            )
        for file in sorted(path.rglob("*.toml")) if path.is_dir() else [path]:
            found.setdefault(file.resolve(), file)
    return list(found.values())


def _instant(path: Path) -> Instant:
    parameters = IdentifiedParameters.load(path)
    try:
        tests = kept_tests(parameters) or []
    except ParametersFileError as fault:
        raise ParametersFileError(f"{path}: {fault}") from fault
    recorded = [_aware(t.recorded) for t in tests if t.recorded is not None]
    time = min(recorded) if recorded else datetime.fromtimestamp(path.stat().st_mtime, UTC)
    return Instant(path, time, bool(recorded), str(parameters.provenance.get("rig", "")), parameters, tests)


def _aware(time: datetime) -> datetime:
    return time if time.tzinfo is not None else time.replace(tzinfo=UTC)


def _steps(instants: list[Instant]) -> list[Comparison | None]:
    """Each instant against the one before; p values count every look of the whole history."""
    steps: list[Comparison | None] = [None]
    for before, after in pairwise(instants):
        try:
            steps.append(compare(before.parameters, after.parameters))
        except NotIdentifiable:
            steps.append(None)
    looked = [c for step in steps if step for c in step.changes]
    counted = iter(holm([c.p for c in looked]))
    return [
        step and replace(step, changes=[replace(c, p_holm=float(next(counted))) for c in step.changes])
        for step in steps
    ]
