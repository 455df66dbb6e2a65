"""`rig recover`: a new, whole log from a cut or damaged one."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from rig_basics.texts import number_of
from rig_cli.console import notify, print_json, show
from rig_cli.option_groups import OUTPUT
from rig_cli.options import Json
from rig_cli.share_progress import share_progress


def recover(
    part: Annotated[Path, Parameter(help="the cut or damaged log")],
    *,
    output: Annotated[Path | None, Parameter(name=["--output", "-o"], group=OUTPUT, help="the new log")] = None,
    json: Json = False,
) -> int:
    """Make a cut or damaged log whole, and list what is missing.

    The intact part becomes a new file. Exit 1 when no message could be kept.

    Example: `rig recover run.mcap.part`
    """
    from daq.log.recover import recover as make_whole  # numba takes a third of a second to import

    with share_progress(f"recovering {part.name}") as progress:
        found = make_whole(part, output, progress)
    nothing = found.messages == 0  # then at most facts and attachments are kept
    if json:
        print_json(
            {
                "log": str(found.path),
                "origin": str(part),
                "recovered": "nothing" if nothing else "part" if found.missing else "all",
                "messages": found.messages,
                "chunks": found.chunks,
                "span_s": found.seconds,
                "missing": [
                    {**vars(place), "topics": list(place.topics), "sentence": str(place)} for place in found.missing
                ],
            }
        )
        return 1 if nothing else 0
    notify(f"{number_of(found.messages, 'message')} over {found.seconds:.3f} s kept in {found.path}")
    for place in found.missing:
        show(f"missing    {place}")
    if not found.missing:
        notify(f"nothing in {part} is cut or damaged: it needed no recovery")
    if nothing:
        notify("no message was left to recover: the new log contains only facts of the run and attached files")
    return 1 if nothing else 0
