"""Set-up of an optoNCDT sensor: the commands of its manual in order, with checked answers."""

from __future__ import annotations

import queue
import re
from collections.abc import Sequence
from typing import Any

from daq.drivers.contract import Talk
from daq.drivers.optoncdt import distance_words, sensor_answers
from daq.drivers.optoncdt.settings import Laser
from daq.drivers.stream_stop import stop_stream
from daq.errors import DeviceError

_ANSWER_S = 1.0  # wall seconds
_ARGUMENT_OR_ACCESS = re.compile(r"access|denied|parameter|argument|value|range|timeout", re.IGNORECASE)


def configure(device: str, config: Laser, talk: Talk) -> dict[str, Any]:
    """Stop the stream, identify the sensor, select the output words and start the stream.

    A host that was killed leaves its sensor streaming. The bytes of that stream do not belong to the new recording, and
    its counter and timestamp may not continue. The stream is therefore stopped until the line is silent.

    Returns:
        Identity: name, serial, version, range_m, scaling, words.

    Raises:
        DeviceError: the sensor does not answer, refuses a command, or differs from the rig file.
    """
    if not stop_stream(talk, b"OUTPUT NONE\n"):
        raise DeviceError(
            f"{device} on {config.port}: sent OUTPUT NONE several times, it goes on streaming. Does its line carry "
            "commands too (both wire pairs of RS422), and does another program or master command it? Switch it off "
            "and on"
        )
    talk.restart_decoding()
    dialogue = _Dialogue(device, config, talk)
    dialogue.command("OUTPUT NONE")  # the answer to the first one may have been lost in the stream
    dialogue.command("ECHO ON")
    info = sensor_answers.parse_info(dialogue.command("GETINFO"))
    scaling = _checked_scaling(device, config, info)
    dialogue.command("OUTHOLD NONE")
    dialogue.command("OUTREDUCEDEVICE NONE", may_lack=True)  # omitted samples would count as lost
    if scaling != distance_words.MASTERED:  # a zero set in the sensor shifts its words
        dialogue.command("MASTERMV NONE", may_lack=True)
    dialogue.command(f"MEASRATE {config.rate_Hz / 1000:g}")
    dialogue.command("OUTADD_RS422 COUNTER TIMESTAMP")
    words = config.output_words or _output_words(device, dialogue.command("GETOUTINFO_RS422"))
    dialogue.command("OUTPUT RS422")
    return {**info, "scaling": scaling, "words": list(words)}


class _Dialogue:
    """Commands and their answers."""

    def __init__(self, device: str, config: Laser, talk: Talk) -> None:
        self._device, self._config, self._talk = device, config, talk

    def command(self, text: str, *, may_lack: bool = False) -> list[str]:
        """Send a command and return the lines of the answer.

        If the sensor `may_lack` the command, a refusal and a missing answer are accepted. A refusal of the arguments or
        of the access level is an error in any case.
        """
        replies, clock = self._talk.replies, self._talk.clock
        while not replies.empty():
            replies.get_nowait()
        self._talk.send(text.encode("ascii") + b"\n")
        lines: list[str] = []
        deadline = clock.wall_s() + _ANSWER_S
        while (left := deadline - clock.wall_s()) > 0:
            try:
                line = replies.get(timeout=left)
            except queue.Empty:  # usual: the sensor sends no further line
                break
            if line == sensor_answers.PROMPT:
                bad = next((x for x in lines if x[:1] == "E" and x[1:4].isdigit()), None)
                if bad and (not may_lack or _ARGUMENT_OR_ACCESS.search(bad)):
                    raise DeviceError(
                        f"{self._device}: {text!r} refused: {bad}. Check rate and output words in the rig file"
                    )
                return lines
            lines.append(line)
        if may_lack:
            return lines
        raise DeviceError(
            f"{self._device} on {self._config.port}: no answer to {text!r} within {_ANSWER_S:g} s (got {lines}). "
            f"Is the baud rate {self._config.baud} and the sensor powered?"
        )


def _checked_scaling(device: str, config: Laser, info: sensor_answers.SensorInfo) -> str:
    """Return the scaling of the sensor.

    Raises:
        DeviceError: the sensor has another range than the rig file, or its scaling is unknown.
    """
    if abs(info["range_m"] - config.range_m) > 1e-6:
        raise DeviceError(
            f"{device}: the range is {config.range_m * 1e3:g} mm in the rig file and {info['range_m'] * 1e3:g} mm in "
            f"the sensor (serial {info['serial']}). Correct devices.{device}.range_m or plug in the right sensor"
        )
    scaling = config.scaling or distance_words.scaling_of(info["name"])
    if scaling is None:
        each = [(key, ", ".join(scaling.models)) for key, scaling in distance_words.SCALINGS.items() if scaling.models]
        known = "; ".join(f"{models} as {key}" for key, models in each)
        raise DeviceError(
            f"{device}: expected a sensor whose scaling is known, models {known}; got {info['name']!r} (serial "
            f"{info['serial']}). If it has the scaling of one of these, set devices.{device}.scaling"
        )
    return scaling


def _output_words(device: str, answer: Sequence[str]) -> tuple[str, ...]:
    """Return the output words of an answer to GETOUTINFO_RS422; an echo or a warning may be part of the answer.

    Raises:
        DeviceError: no line has distance, counter and timestamp.
    """
    announced = [words for line in answer if (words := sensor_answers.announced(line)) is not None]
    readable = [words for words in announced if sensor_answers.places_of(words) is not None]
    if not readable:
        raise DeviceError(
            f"{device}: expected distance, counter and timestamp among its output words, got {list(answer)!r:.200} in "
            "answer to GETOUTINFO_RS422: does its firmware have OUTADD_RS422 COUNTER TIMESTAMP? If these words are in "
            f"its stream by other names, set devices.{device}.words, in stream order"
        )
    return readable[-1]
