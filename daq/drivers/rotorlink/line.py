"""Decoding of the bytes of a serial line to RotorLink frames: COBS runs ended by 0x00."""

from __future__ import annotations

from dataclasses import dataclass

from daq.drivers.rotorlink import byte_stuffing, wire

RUN_LIMIT_BYTES = 300
"""Longest run of bytes that can be a frame."""


@dataclass(frozen=True)
class DecodedFrames:
    """Result of one call of `FrameDecoder.feed`.

    Attributes:
        frames: intact frames in order, including a `Wrapped` around a damaged payload, and `Skipped` frames, which are
            in `bad` too.
        bad: reason and bytes of what is not a frame; ``inner …`` reasons belong to a `Wrapped` that is in `frames`.
    """

    frames: list[wire.Frame]
    bad: list[tuple[str, bytes]]


class FrameDecoder:
    """Decode the bytes of a serial line to frames. The result does not depend on the split into calls.

    Memory is bounded.
    """

    def __init__(self) -> None:
        self._run = bytearray()
        self._overlong = False

    def feed(self, data: bytes) -> DecodedFrames:
        """Decode the next bytes of the line.

        Args:
            data: any number of bytes, in the order of arrival.
        """
        found = DecodedFrames([], [])
        *ended, tail = data.split(b"\x00")
        for run in ended:
            self._extend(run, found)
            if self._run and not self._overlong:
                _decode_run(bytes(self._run), found)
            self._run.clear()
            self._overlong = False
        self._extend(tail, found)
        return found

    def _extend(self, run: bytes, found: DecodedFrames) -> None:
        """Extend the present run; a run that is too long for a frame is reported once and dropped."""
        if self._overlong:
            return
        self._run += run[: RUN_LIMIT_BYTES + 1 - len(self._run)]
        if len(self._run) > RUN_LIMIT_BYTES:
            found.bad.append(("overlong", bytes(self._run[:RUN_LIMIT_BYTES])))
            self._run.clear()
            self._overlong = True


def _decode_run(run: bytes, found: DecodedFrames) -> None:
    try:
        payload = byte_stuffing.decode(run)
    except byte_stuffing.DecodeError:  # usual: the run is damaged, which `bad` states
        found.bad.append(("cobs", run))
        return
    try:
        frame = wire.parse(payload)
    except wire.BadFrame as fault:
        found.bad.append((fault.reason, payload))
        if fault.skipped is not None:
            found.frames.append(fault.skipped)
        return
    found.frames.append(frame)
    if isinstance(frame, wire.Wrapped) and frame.damage:
        found.bad.append((f"inner {frame.damage}", frame.damaged))
