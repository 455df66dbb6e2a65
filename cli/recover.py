"""`rig recover`: a cut or damaged log made whole."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from cli.console import print_json, say, share_progress
from cli.options import Json


def recover(
    part: Path, *, output: Annotated[Path | None, Parameter(name=["--output", "-o"])] = None, json: Json = False
) -> int:
    """Make a cut or damaged log whole: a new file of all that is sound in it; says what is missing."""
    from daq.log.recover import recover as make_whole  # noqa: PLC0415 (numba takes a third of a second to import)

    with share_progress(f"recovering {part.name}") as progress:
        found = make_whole(part, output, progress)
    if json:
        print_json(
            {
                "log": str(found.path),
                "origin": str(part),
                "messages": found.messages,
                "chunks": found.chunks,
                "span_s": found.seconds,
                "missing": [
                    {**vars(place), "topics": list(place.topics), "sentence": str(place)} for place in found.missing
                ],
            }
        )
        return 0
    say(f"{found.messages} messages over {found.seconds:.3f} s kept in {found.path}")
    for place in found.missing:
        print(f"missing    {place}")
    if not found.missing:
        say(f"nothing in {part} is cut or damaged: it needed no recovery")
    return 0
