"""New identification of every campaign of an archive, with the current software or another rig file."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from typing_extensions import override

from daq.errors import LogError, RecordingError
from daq.log.rig_of_logs import RigText, RigUse, rig_of_logs
from daq.log.verdicts import digest_of
from identification import IdentificationError, identify
from rig_configs import IdentifiedParameters, RigFileError
from studies.errors import StudyInputError
from studies.runs import load_runs
from studies.study import Answer, Kind, Study
from studies.tile_files import TileFolder


@dataclass(frozen=True)
class ArchivedCampaign:
    """Logs that are identified together.

    Attributes:
        name: folder of the logs, relative to the archive.
        logs: absolute paths, the same on every worker's host.
    """

    name: str
    logs: tuple[Path, ...]


def campaigns_in(archives: Sequence[Path]) -> list[ArchivedCampaign]:
    """Return the campaigns of archives; the logs of one folder are one campaign.

    Raises:
        StudyInputError: the archives contain no log.
    """
    found: list[ArchivedCampaign] = []
    for archive in archives:
        folders: dict[Path, list[Path]] = {}
        for log in sorted(archive.rglob("*.mcap")):
            folders.setdefault(log.parent, []).append(log.resolve())
        for folder, logs in sorted(folders.items()):
            inner = folder.relative_to(archive)
            found.append(ArchivedCampaign((archive.name / inner).as_posix(), tuple(logs)))
    if not found:
        raise StudyInputError(f"no log in {', '.join(map(str, archives))}: expected folders with NAME.mcap files")
    return found


def archive_study(
    rig: RigText | None,
    settings: Sequence[str],
    campaigns: Sequence[ArchivedCampaign],
    progress: Callable[[float], None] | None = None,
) -> Study:
    """Return the study that identifies campaigns again. Every log is read for its digest.

    Args:
        rig: a rig file's name and text; None: each campaign's own rig.
        settings: "key=value" settings applied to the rig.
        campaigns: campaigns of the archives.
        progress: called with the share of the logs that has been read, 0 … 1.
    Raises:
        LogError: a log cannot be read.
    """
    total, done, rows = sum(len(one.logs) for one in campaigns), 0, list[dict[str, Any]]()
    for one in campaigns:
        digests: dict[str, str] = {}
        for log in one.logs:
            digests[str(log)] = digest_of(log)
            done += 1
            if progress is not None:
                progress(done / total)
        rows.append({"name": one.name, "logs": digests})
    return Study.of("archive", {"rig": rig, "settings": list(settings), "campaigns": rows})


@lru_cache(maxsize=4)
def _question(text: str) -> Mapping[str, Any]:
    return json.loads(text)


class Archive(Kind):
    """Kind of study: a campaign's parameters as the text of parameters.toml, and warnings.

    A campaign whose logs identify nothing has an `error` in words instead.
    """

    uses_threads = False

    @override
    def tiles(self, text: str) -> int:
        return len(_question(text)["campaigns"])

    @override
    def part(self, text: str, tile: int) -> str:
        """Return the part of one campaign, whose result does not depend on the others."""
        question = _question(text)
        own = {name: value for name, value in question.items() if name != "campaigns"}
        return Study.question(own | {"campaign": question["campaigns"][tile]})

    @override
    def warm_up(self, text: str) -> None:
        """Do nothing: the import is sufficient, and the first campaign compiles the remaining code."""

    @override
    def answer(self, text: str, tile: int, threads: int) -> Answer:
        """Identify one campaign."""
        question = _question(text)
        name, logs = question["campaigns"][tile]["name"], question["campaigns"][tile]["logs"]
        given, settings = question["rig"], question["settings"]
        try:
            runs = load_runs(list(logs))
            for run in runs:
                if run.metadata["digest"] != logs[run.source]:
                    raise StudyInputError(
                        f"{run.source}: expected the log with {logs[run.source]}, found "
                        f"{run.metadata['digest']}; give all hosts access to the same archive"
                    )
            rig = rig_of_logs(list(logs), RigUse(name), None if given is None else tuple(given), settings=settings)
            found = identify(runs, rig)
        except (IdentificationError, LogError, RecordingError, RigFileError) as fault:
            return {"name": np.array(name), "error": np.array(f"{type(fault).__name__}: {fault}")}
        return {
            "name": np.array(name),
            "parameters": np.array(_toml(found.parameters)),
            "warnings": np.array(found.warnings, dtype=str),
        }


def _toml(parameters: IdentifiedParameters) -> str:
    with tempfile.TemporaryDirectory(prefix="rig-archive-") as folder:
        path = Path(folder) / "parameters.toml"
        parameters.save(path)
        return path.read_text(encoding="utf-8")


@dataclass(frozen=True)
class Reidentified:
    """New identification of one campaign.

    Attributes:
        name: name of the campaign.
        parameters: parameters; None if the logs identify nothing.
        text: text of its parameters.toml, or the reason why it does not exist.
        warnings: warnings of the identification.
    """

    name: str
    parameters: IdentifiedParameters | None
    text: str
    warnings: tuple[str, ...]

    @classmethod
    def all_of(cls, folder: TileFolder) -> list[Reidentified]:
        """Read the finished tiles of a folder.

        Raises:
            FolderFault: a tile is damaged.
        """
        found: list[Reidentified] = []
        for tile in sorted(folder.finished()):
            row = folder.read(tile)
            name = str(row["name"])
            if "error" in row:
                found.append(cls(name, None, str(row["error"]), ()))
            else:
                text = str(row["parameters"])
                known = IdentifiedParameters.from_text(text, name)
                found.append(cls(name, known, text, tuple(map(str, row["warnings"]))))
        return found


KIND = Archive()
