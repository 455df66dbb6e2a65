"""Catalogue entry of one file; `daq.catalogue.facts` reads it from the file."""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel, JsonValue

from daq.log.verdicts import LoggedVerdict

State = Literal["finished", "recovered", "unfinished", "damaged", "foreign", "unreadable"]


class Entry(BaseModel, extra="forbid", frozen=True):
    """Facts of one file in the catalogue's folder. Facts that the file does not contain are empty or None.

    Attributes:
        path: path relative to the folder, with "/".
        size_bytes: size of the file.
        state: "finished"; "recovered"; "unfinished": cut, or still being recorded; "damaged"; "foreign": an MCAP file
            that is not a recording of a rig; "unreadable".
        complete: True if nothing is found missing when the file is opened, which does not read the samples. False for
            a recovered log that had losses before its recovery.
        why: what is wrong with an incomplete file, in one line.
        rig, test, point, note, software: values of the run's metadata.
        started: start of the recording, ISO 8601; `started_ns` is the same in ns since 1970.
        duration_s: time from the first message to the last, s.
        parameters: identified parameters laid over the rig file; empty if the rig file's own values were used.
        origin: source of a log that was decoded again, imported or recovered.
        messages: number of messages.
        lost: number of samples and frames that did not arrive; None if losses were not counted.
        losses: counts by device and kind; `losses_from` is the place they were read from.
        outcome: result written by the test at its end (settled, rung_down, ended …).
        verdict: result of the last validation; "stale" if the log has changed since, "unreadable" if the verdict file
            cannot be read, empty without a verdict file.
        judged: that verdict in full.
    """

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
    judged: LoggedVerdict | None = None
