"""A rig's parameters over time, from its parameters files.

Each file is one instant, the time at which its logs were recorded. The tests in a file contain the values of each log
in addition to the joint values, so that no fit is repeated. A log enters the history by `rig identify LOG… -o FILE`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from itertools import pairwise
from pathlib import Path

from identification.compare import ParameterComparison, compare_parameters, holm
from identification.errors import NotIdentifiable
from identification.joint.provenance import KeptTest, kept_tests
from rig_basics.tabular import Column, Tabular
from rig_configs.errors import ParametersFileError
from rig_configs.parameters_file import IdentifiedParameters


@dataclass(frozen=True)
class Instant:
    """One parameters file.

    Attributes:
        path: path of the file.
        time: start of the first recording of its logs, or the file's modification time if the file has no such time.
        time_known: whether `time` is the start of a recording.
        rig: name of the rig; "" if unknown.
        parameters: parameters in the file.
        tests: tests in the file; empty if it contains none.
    """

    path: Path
    time: datetime
    time_known: bool
    rig: str
    parameters: IdentifiedParameters
    tests: list[KeptTest]


@dataclass(frozen=True)
class History(Tabular):
    """A rig's parameters over time.

    Attributes:
        instants: files in order of time.
        steps: comparison of each file with the previous one; None for the first and if they share no parameter.
            p_holm is adjusted for all comparisons of the history.
        skipped: TOML files without parameters, with the reason.
    """

    instants: list[Instant]
    steps: list[ParameterComparison | None]
    skipped: list[str]

    @property
    def remarks(self) -> list[str]:
        """The files that are not in the table."""
        return self.skipped

    def columns(self) -> Mapping[str, Column]:
        """Return each file's time, and its values with their standard deviations; NaN for absent ones."""
        each = [instant.parameters for instant in self.instants]
        names = dict.fromkeys(name for parameters in each for name in parameters.values)
        table: dict[str, Column] = {"time": [i.time for i in self.instants], "file": [i.path for i in self.instants]}
        for name in names:
            table[name] = [parameters.values.get(name, math.nan) for parameters in each]
            table[f"{name}_std"] = [parameters.std.get(name, math.nan) for parameters in each]
        return table


def parameter_history(paths: Sequence[Path], rig: str | None = None) -> History:
    """Build the history from parameters files.

    Args:
        paths: files and folders. Folders are searched recursively for .toml files with a covariance.
        rig: name of the rig, if the files belong to several rigs.
    Raises:
        ParametersFileError: a given file is not a parameters file, or the files belong to several rigs and `rig` is
            None.
        NotIdentifiable: no parameters file was found.
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
        raise NotIdentifiable(f"{', '.join(map(str, paths))}: no parameters file found. `rig identify` writes one")
    rigs = sorted({i.rig for i in instants if i.rig})
    if rig is None and len(rigs) > 1:
        raise ParametersFileError(f"these files are of several rigs: {', '.join(rigs)}. Choose one of them")
    chosen = [i for i in instants if rig is None or i.rig == rig]
    if not chosen:
        raise ParametersFileError(f"no file is of rig {rig!r}; found: {', '.join(rigs) or 'files without a rig name'}")
    chosen.sort(key=lambda i: i.time)
    return History(chosen, _steps(chosen), skipped)


def _files(paths: Sequence[Path]) -> list[Path]:
    found: dict[Path, Path] = {}
    for path in paths:
        if path.suffix == ".mcap":
            raise ParametersFileError(
                f"{path}: expected a parameters file, got a log. `rig identify` finds its parameters: "
                "give the file that it writes"
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


def _steps(instants: list[Instant]) -> list[ParameterComparison | None]:
    """Compare each instant with the previous one. The p values are adjusted for all comparisons of the history."""
    steps: list[ParameterComparison | None] = [None]
    for before, after in pairwise(instants):
        try:
            steps.append(compare_parameters(before.parameters, after.parameters))
        except NotIdentifiable:  # usual: two files that share no parameter
            steps.append(None)
    looked = [c for step in steps if step for c in step.changes]
    counted = iter(holm([c.p for c in looked]))
    return [
        step and replace(step, changes=[replace(c, p_holm=float(next(counted))) for c in step.changes])
        for step in steps
    ]
