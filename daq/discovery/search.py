"""Search for the device on one port: first by receiving only, then, if requested, by requests for identification.

Receiving: the port is opened with the line of each trial and read for a moment. A serial line without a device is
silent at every rate, and a device that sends gives bytes at every rate, so a silent line is left after one look. Each
driver decodes the bytes; the driver with the fewest losses is the candidate.

Asking: each driver's request for identification is sent, at each of its usual lines, until one is answered. A port on
which a candidate was found gets the request of this driver only.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

from daq.discovery.opening import PortNotOpened, State, has_line_rate, open_port
from daq.discovery.trials import Evidence, Reads, Trial, evidence_of, trials_of
from daq.drivers.contract import DeviceLine
from daq.drivers.driver import Driver
from daq.drivers.identification import FoundDevice, IdentityTurns
from daq.errors import LinkLost
from daq.transports import HostClock, Link

_log = logging.getLogger(__name__)

_SILENCE_S = 1.2  # s; nodes and drives report at least each second
_LOOK_S = 0.4  # s for which a line with bytes is read at each rate
_FULL_LOOK_S = 1.3  # s for which the line of a candidate is read: the report of each second is among its bytes
_READ_S = 0.02
_MOST_BYTES = 1_000_000  # of one look

Progress = Callable[[str, float], None]
"""Called with the present activity and the completed share of the port's search, 0 … 1."""


@dataclass(frozen=True)
class Result:
    """What was found on a port.

    Attributes:
        port: the port, as it was opened.
        state: "device", "unknown device" (bytes that no driver decodes), "silent", or why it was not opened.
        note: text for the operator: why, and what to do.
        evidence: what shows the device: driver, settings, identity, samples; None without a device.
        how: "received" or "answered": whether it was recognised without a request.
        bytes_in: number of bytes received without a request.
        others: names of other drivers that decode the bytes too.
        seconds: duration of the search, s.
    """

    port: str
    state: Literal["device", "unknown device", "silent"] | State
    note: str = ""
    evidence: Evidence | None = None
    how: Literal["", "received", "answered"] = ""
    bytes_in: int = 0
    others: tuple[str, ...] = ()
    seconds: float = 0.0


class PortSearch:
    """Search on one port.

    Args:
        port: the port, in the notation of a rig file.
        drivers: drivers to try.
        clock: clock of the waits.
        progress: see Progress.
        connect: opens a line; raises PortNotOpened.
    """

    def __init__(
        self,
        port: str,
        drivers: Iterable[Driver],
        clock: HostClock,
        progress: Progress,
        connect: Callable[[DeviceLine], Link] = open_port,
    ) -> None:
        self._port, self._clock, self._progress, self._connect = port, clock, progress, connect
        self._trials = trials_of(drivers, port, has_line_rate(port))
        self._bytes_in = 0

    def run(self, ask: bool) -> Result:
        """Search the port.

        Args:
            ask: whether requests for identification may be sent.
        """
        began = self._clock.now_s()
        try:
            result = self._received()
            if ask:
                result = self._asked(result)
        except PortNotOpened as error:
            result = Result(self._port, error.state, str(error))
        except LinkLost as error:
            result = Result(self._port, "not opened", str(error))
        return replace(result, bytes_in=self._bytes_in, seconds=self._clock.now_s() - began)

    # --- receiving -----------------------------------------------------------------------------------------------

    def _received(self) -> Result:
        lines = _lines(self._trials)
        if not has_line_rate(self._port):
            lines = lines[:1]
        for i, line in enumerate(lines):
            self._progress(f"receiving {_words(line)}", 0.5 * i / len(lines))
            trials = self._trials if len(lines) == 1 else [each for each in self._trials if each.line == line]
            link = self._connect(line)
            try:
                reads = self._read(link, _SILENCE_S if i == 0 else _LOOK_S, _LOOK_S)
                if not reads and i == 0:
                    return Result(self._port, "silent")
                best = _best(trials, reads)
                if best:
                    reads += self._read(link, _FULL_LOOK_S, _FULL_LOOK_S)
                    return self._candidate(_best([each.trial for each in best], reads) or best)
            finally:
                link.close()
        return Result(self._port, "unknown device", "it sends bytes that no installed driver decodes")

    def _candidate(self, best: Sequence[Evidence]) -> Result:
        first = best[0]
        others = {each.trial.driver.name for each in best[1:]} - {first.trial.driver.name}
        found = FoundDevice({**_line_settings(first.trial), **first.found.settings}, first.found.identity)
        evidence = replace(first, found=found)
        return Result(self._port, "device", evidence=evidence, how="received", others=tuple(sorted(others)))

    def _read(self, link: Link, silence_s: float, look_s: float) -> list[tuple[bytes, int]]:
        """Read a port: for `silence_s` while it is silent, for `look_s` from its first byte; s."""
        reads: list[tuple[bytes, int]] = []
        size, end = 0, self._clock.now_s() + silence_s
        while (left := end - self._clock.now_s()) > 0 and size < _MOST_BYTES:
            data = link.read(min(left, _READ_S))
            if not data:
                continue
            if not reads:
                end = self._clock.now_s() + look_s
            reads.append((data, self._clock.now_ns()))
            size += len(data)
        self._bytes_in += size
        return reads

    # --- asking --------------------------------------------------------------------------------------------------

    def _asked(self, before: Result) -> Result:
        """Return the answer to a request for identification; without an answer what was found before."""
        trials = self._trials if before.evidence is None else [before.evidence.trial]
        trials = [each for each in trials if each.driver.identity_request is not None]
        done = 0
        for line in _lines(trials):
            link = self._connect(line)
            try:
                for trial in (each for each in trials if each.line == line):
                    self._progress(f"asking as {trial.driver.name} {_words(line)}", 0.5 + 0.5 * done / len(trials))
                    done += 1
                    found = self._ask(link, trial)
                    if found is not None:
                        return _with_answer(before, trial, found)
            finally:
                link.close()
        return before

    def _ask(self, link: Link, trial: Trial) -> FoundDevice | None:
        assert trial.driver.identity_request is not None
        turns: IdentityTurns = trial.driver.identity_request(trial.settings)
        try:
            request = next(turns)
            while True:
                if request.data:
                    link.write(request.data)
                received, end = b"", self._clock.now_s() + request.wait_s
                while (left := end - self._clock.now_s()) > 0 and len(received) < _MOST_BYTES:
                    if data := link.read(min(left, _READ_S)):
                        received += data
                        if request.is_answered(received):
                            break
                request = turns.send(received)
        except StopIteration as end_of_turns:
            found: FoundDevice | None = end_of_turns.value
            return found


def _lines(trials: Iterable[Trial]) -> list[DeviceLine]:
    """Return the different lines of trials in their order."""
    return list(dict.fromkeys(trial.line for trial in trials))


def _best(trials: Iterable[Trial], reads: Reads) -> list[Evidence]:
    """Return the evidence that convinces, the best first."""
    found = [evidence for trial in trials if (evidence := evidence_of(trial, reads)) is not None]
    return sorted((each for each in found if each.convinces), key=lambda each: each.rank)


def _with_answer(before: Result, trial: Trial, found: FoundDevice) -> Result:
    """Return the result of a port whose device answered, with what was received before."""
    heard = before.evidence or Evidence(trial, FoundDevice())
    settings = {**heard.found.settings, **_line_settings(trial), **found.settings}
    both = FoundDevice(settings, {**heard.found.identity, **found.identity})
    evidence = replace(heard, trial=trial.with_settings(settings), found=both)
    return replace(before, state="device", note="", evidence=evidence, how=before.how or "answered")


def _line_settings(trial: Trial) -> dict[str, Any]:
    """Return those settings of a trial that state its line."""
    table = trial.settings.model_dump()
    return {key: table[key] for key in ("baud", "parity", "bitrate") if key in table}


def _words(line: DeviceLine) -> str:
    return f"at {line.baud} baud, parity {line.parity}" if has_line_rate(line.port) else f"on {line.port}"
