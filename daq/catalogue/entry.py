"""What the catalogue knows of one file; `daq.catalogue.facts` reads it from the file."""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel, ConfigDict, JsonValue

from daq.log.verdicts import Verdict

State = Literal["finished", "recovered", "unfinished", "damaged", "foreign", "unreadable"]


class Entry(BaseModel):
    """Facts of one file in the catalogue's folder; what a file does not say is empty or None.

    Attributes:
        path: relative to the folder, with "/".
        size_bytes: of the file.
        state: "finished"; "recovered"; "unfinished": cut, or still being recorded; "damaged"; "foreign": an MCAP file
            that is no recording of a rig; "unreadable".
        complete: nothing is known to be missing, in a recovered log also not since before; known from opening it,
            which does not read the samples.
        why: what is wrong with a file that is not whole, in one line.
        rig, test, point, note, software: as the run's metadata have them.
        started: when the recording began, ISO 8601; `started_ns` the same in ns since 1970.
        duration_s: from the first message to the last.
        parameters: the identified parameters laid over the rig file; empty for the rig file's own numbers.
        origin: what it was made of, for a log that was decoded anew, imported or recovered.
        messages: how many.
        lost: samples and frames that did not arrive; None where nobody counted.
        losses: counts by device and kind; `losses_from` is where they were found.
        outcome: what the test itself said at its end (settled, rung_down, ended …).
        verdict: of the last validation; "stale" when the log is not the one that was judged, "unreadable" when the
            verdict's file is, empty without one.
        judged: that verdict in full.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    path: str
    size_bytes: int
    state: State
    complete: bool = False
    why: str = ""
    rig: str = ""
    test: str = ""
    point: str = ""
    note: str = ""
    software: str = ""
    started: str = ""
    started_ns: int | None = None
    duration_s: float = 0.0
    parameters: str = ""
    origin: str = ""
    messages: int = 0
    lost: int | None = None
    losses: dict[str, dict[str, int]] = {}
    losses_from: str = ""
    outcome: dict[str, JsonValue] = {}
    verdict: str = ""
    judged: Verdict | None = None
