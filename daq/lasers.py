"""Setting up an optoNCDT sensor: the commands of its manual, in order, with the answers checked."""

from __future__ import annotations

import queue
import time
from collections.abc import Callable
from typing import Any

from daq.errors import DeviceError
from daq.protocols import optoncdt
from rig_configs.schema import Laser

_ANSWER_S = 1.0  # wall seconds
_QUIET_S = 0.1


def configure(device: str, config: Laser, send: Callable[[bytes], None], replies: queue.Queue[str]) -> dict[str, Any]:
    """Stop the stream, ask who it is, choose the output words, start the stream.

    Args:
        send: writes bytes to the sensor.
        replies: answer lines as the pipeline decodes them, the prompt being a line of its own.
    Returns:
        Identity: name, serial, version, range_m, words.
    Raises:
        DeviceError: no answer, a refusal, or a sensor that is not what the rig file says.
    """

    def command(text: str) -> list[str]:
        while not replies.empty():
            replies.get_nowait()
        send(text.encode("ascii") + b"\n")
        lines: list[str] = []
        deadline = time.monotonic() + _ANSWER_S
        while time.monotonic() < deadline:
            try:
                line = replies.get(timeout=max(0.01, deadline - time.monotonic()))
            except queue.Empty:
                break
            if line == optoncdt.PROMPT:
                bad = next((x for x in lines if x[:1] == "E" and x[1:4].isdigit()), None)
                if bad:
                    raise DeviceError(f"{device}: {text!r} refused: {bad}. Check rate and output words in the rig file")
                return lines
            lines.append(line)
        raise DeviceError(
            f"{device} on {config.port}: no answer to {text!r} within {_ANSWER_S:g} s (got {lines}). "
            f"Is the baud rate {config.baud} and the sensor powered?"
        )

    send(b"OUTPUT NONE\n")  # while it streams, its answer may drown: ask again once it is quiet
    _quiet(replies)
    command("OUTPUT NONE")
    command("ECHO ON")
    info = optoncdt.parse_info(command("GETINFO"))
    if abs(info["range_m"] - config.range_m) > 1e-6:
        raise DeviceError(
            f"{device}: rig file says range {config.range_m * 1e3:g} mm, the sensor {info['range_m'] * 1e3:g} mm "
            f"(serial {info['serial']}). Correct devices.{device}.range_m or plug in the right sensor"
        )
    command("OUTHOLD NONE")
    command(f"MEASRATE {config.rate_Hz / 1000:g}")
    command("OUTADD_RS422 COUNTER TIMESTAMP")
    answer = next((x for x in command("GETOUTINFO_RS422") if x.upper().startswith("GETOUTINFO_RS422 ")), "")
    words = optoncdt.parse_outinfo(answer)
    if optoncdt.places_of(words) is None:
        raise DeviceError(
            f"{device}: expected distance, counter and timestamp among its output words, got {' '.join(words)}: "
            "does its firmware know OUTADD_RS422 COUNTER TIMESTAMP?"
        )
    command("OUTPUT RS422")
    return {**info, "words": list(words)}


def _quiet(replies: queue.Queue[str]) -> None:
    """Wait until no answer has come for a while, so that a late one is not taken for the next command's."""
    deadline = time.monotonic() + _ANSWER_S
    while time.monotonic() < deadline:
        try:
            replies.get(timeout=_QUIET_S)
        except queue.Empty:
            return
