"""Studies of many campaigns: on the virtual rig, or of an archive of logs; on one machine or many."""

from __future__ import annotations

import json as json_text
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from cyclopts import App, Parameter
from numpy.typing import NDArray

from rig_basics.texts import number_of
from rig_basics.whole_file import write_whole_text
from rig_cli.console import notify, print_json
from rig_cli.numbers import WholeCount
from rig_cli.options import Json, RigFile, Settings
from rig_cli.scheduler import Scheduler, worked_out
from rig_cli.share_progress import share_progress
from rig_configs import RigFileError
from rig_configs.load import rig_text

if TYPE_CHECKING:
    from studies.archive import Reidentified
    from studies.campaigns import CampaignResults

app: App = App(name="study")
Out = Annotated[Path, Parameter(name=["--out", "-o"], help="folder for results and tiles; its study continues")]


@app.command
def campaigns(
    rig: RigFile = "virtual",
    *,
    runs: Annotated[WholeCount, Parameter(help="how many campaigns")] = 100,
    seed: Annotated[int, Parameter(help="of the first; those of the others count up from it")] = 0,
    out: Out = Path("out/campaigns"),
    scheduler: Scheduler = None,
    settings: Settings = None,
    json: Json = False,
) -> int:
    """Run campaigns on the virtual rig: how often the truth is in the stated intervals, and how often points pass.

    Example: `rig study campaigns`
    """
    from studies.campaigns import CampaignResults, campaign_study, need_virtual  # loads numba

    need_virtual(rig, settings or [])
    study = campaign_study(rig_text(rig)[1], settings or [], seed, runs)
    folder = worked_out(study, _made(out) / "tiles", scheduler, "campaigns")
    found = CampaignResults.of(folder)
    result = {"rig": rig, "seed": seed, "settings": list(settings or []), **_campaigns_json(found)}
    write_whole_text(out / "campaigns.json", json_text.dumps(result, indent=1, ensure_ascii=False))
    if json:
        print_json({**result, "file": str(out / "campaigns.json")})
        return 0
    print(f"{number_of(len(found.done), 'campaign')}, {found.passed} with every point passed")
    print(f"{'':24}{'n':>6}{'in 95 %':>9}{'(95 % sure)':>14}{'mean z':>8}{'sd z':>7}{'max |z|':>9}")
    for title, rows in (("parameters", found.parameter_z()), ("points", found.point_z())):
        for name, z in [*rows.items(), (f"all {title}", np.concatenate([*rows.values(), np.empty(0)]))]:
            if len(z):
                print(_line(name, z))
    for point, counts in found.verdicts().items():
        print(f"{point}: {', '.join(f'{count} {verdict}' for verdict, count in counts.items())}")
    for failed, why in found.failed.items():
        notify(f"seed {failed} did not reach its end: {why}")
    notify(f"written to {out / 'campaigns.json'}")
    return 0


@app.command
def archive(
    *folders: Path,
    rig: Annotated[str | None, Parameter(help="a rig file instead of the logs' own, of the same rig")] = None,
    out: Out = Path("out/archive"),
    scheduler: Scheduler = None,
    settings: Settings = None,
    json: Json = False,
) -> int:
    """Identify every campaign of an archive again; the logs of one folder are one campaign.

    Example: `rig study archive archive`
    """
    from studies.archive import Reidentified, archive_study, campaigns_in  # loads numba

    if not folders:
        raise RigFileError("no folder given; usage: rig study archive FOLDER…")
    for each in folders:
        if not each.is_dir():
            raise RigFileError(f"{each}: expected a folder of logs")
    found = campaigns_in(folders)
    given = None if rig is None else rig_text(rig)
    with share_progress(f"digests of {number_of(sum(len(one.logs) for one in found), 'log')}") as progress:
        study = archive_study(given, settings or [], found, progress)
    rows = Reidentified.all_of(worked_out(study, _made(out) / "tiles", scheduler, "campaigns"))
    written = [_written(row, out) for row in rows]
    result = {"rig": rig, "settings": list(settings or []), "campaigns": written}
    write_whole_text(out / "archive.json", json_text.dumps(result, indent=1, ensure_ascii=False))
    if json:
        print_json({**result, "file": str(out / "archive.json")})
        return 0
    for row, entry in zip(rows, written, strict=True):
        shown = row.text if row.parameters is None else f"{entry['file']}, {number_of(len(row.warnings), 'warning')}"
        print(f"{row.name}: {shown}")
    notify(f"written to {out / 'archive.json'}")
    return 0


def _made(out: Path) -> Path:
    out.mkdir(parents=True, exist_ok=True)
    return out


def _line(name: str, z: NDArray[np.floating]) -> str:
    from studies.campaigns import within
    from uncertainty.binomial import binomial_interval

    inside = within(z)
    low, high = binomial_interval(inside, len(z))
    span = f"{low:.3f}…{high:.3f}"
    return (
        f"{name:24}{len(z):6}{inside / len(z):9.3f}{span:>14}{np.mean(z):8.2f}{np.std(z):7.2f}{np.max(np.abs(z)):9.2f}"
    )


def _campaigns_json(found: CampaignResults) -> dict[str, Any]:
    from studies.campaigns import within

    def covered(rows: dict[str, NDArray[np.floating]]) -> dict[str, Any]:
        return {
            name: {
                "n": len(z),
                "within_95": within(z),
                "mean": float(np.mean(z)),
                "std": float(np.std(z)),
                "largest": float(np.max(np.abs(z))),
            }
            for name, z in rows.items()
        }

    return {
        "campaigns": len(found.done),
        "passed": found.passed,
        "failed": {str(seed): why for seed, why in found.failed.items()},
        "parameters": covered(found.parameter_z()),
        "points": covered(found.point_z()),
        "verdicts": found.verdicts(),
    }


def _written(row: Reidentified, out: Path) -> dict[str, Any]:
    """Write a campaign's parameters into a file of its own; return its entry in the summary."""
    if row.parameters is None:
        return {"name": row.name, "error": row.text}
    path = out / f"{row.name.replace('/', '-')}.toml"
    write_whole_text(path, row.text)
    std = row.parameters.std
    return {
        "name": row.name,
        "file": str(path),
        "parameters": {name: {"value": value, "std": std[name]} for name, value in row.parameters.values.items()},
        "warnings": list(row.warnings),
    }
