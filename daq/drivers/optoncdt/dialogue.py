"""Set-up of an optoNCDT sensor: the commands of its manual in order, with checked answers.

``OUTPUT NONE`` until the line is silent and the command is answered, ``ECHO ON``, ``GETINFO``, ``OUTHOLD NONE``,
``OUTREDUCEDEVICE NONE``, ``MASTERMV NONE``, ``TRIGGER NONE``, ``AVERAGE NONE``, ``MEASRATE``,
``OUTADD_RS422 COUNTER TIMESTAMP``, ``GETOUTINFO_RS422``, ``OUTPUT RS422``. An answer ``E…`` ends the set-up with the
sensor's message. `ECHO`, `OUTHOLD`, `OUTREDUCEDEVICE` and `MASTERMV` may be missing (refused, or no answer); a refusal
of the arguments or a timeout ends the set-up too [U: its wording].

A command without an answer within 1 s is sent once more, with 1.5 s (`MASTERMV` may take 2 s). An acknowledgement of
another command is ignored as late. The laser is not switched on: off is error code 262082.

Identification of an optoNCDT sensor on an unknown port. Queries only: its output is neither stopped nor changed.
"""

from __future__ import annotations

import queue
import re
from collections.abc import Sequence
from functools import partial
from typing import Any

from daq.drivers.contract import Talk
from daq.drivers.displacement import compare_range
from daq.drivers.identification import FoundDevice, IdentityRequest, IdentityTurns
from daq.drivers.optoncdt import distance_words, sensor_answers
from daq.drivers.optoncdt.settings import Laser
from daq.drivers.optoncdt.wire import BlockDecoder
from daq.drivers.questions import stop_stream
from daq.errors import DeviceError
from rig_basics.texts import number_of

_ANSWER_S = (1.0, 1.5)
"""Waits for an answer after the first and after the repeated command, s; MASTERMV takes up to 2 s."""
_QUIET_S = 0.25  # without a further answer, after which no late one follows; s
_MOST_LATE_S = 2.0  # of a sensor that sends lines without end, s
_MOST_BACKLOG_S = 10.0
"""Time for the bytes that waited in buffers when the session began, s: 64 KiB take 5.7 s at 115 200 baud."""
_ACCESS = re.compile(r"access|denied", re.IGNORECASE)
_ARGUMENT = re.compile(r"parameter|argument|value|range|timeout", re.IGNORECASE)
_REFUSAL = re.compile(r"E\d{2,}\b")  # two digits on an ILD2300, otherwise three
_ACKNOWLEDGED = re.compile(r"(\w+)\b.*\bok", re.IGNORECASE)
_BITS_PER_WORD = 30  # three bytes, each with a start bit and a stop bit

_USER_LEVEL = (
    "The sensor is at the user level USER, which cannot change settings: log in as PROFESSIONAL, on its web page or "
    "with LOGIN and its password, and keep that level with STDUSER PROFESSIONAL"
)


def configure(device: str, config: Laser, talk: Talk) -> dict[str, Any]:
    """Stop the stream, identify the sensor, select the output words and start the stream.

    A host that was killed leaves its sensor streaming. The bytes of that stream do not belong to the new recording, and
    its counter and timestamp may not continue. The stream is therefore stopped until the line is silent.

    Returns:
        Identity: name, serial, version, range_m, scaling, words; warning, if a filter or a trigger may be active or
            the line is too slow for the rate.

    Raises:
        DeviceError: the sensor does not answer, refuses a command, or differs from the rig file.
    """
    dialogue = _after_stream(device, config, talk)
    dialogue.command("ECHO ON", may_lack=True)
    info = _info(device, dialogue.command("GETINFO"))
    scaling = _checked_scaling(device, config, info)
    dialogue.command("OUTHOLD NONE", may_lack=True)
    dialogue.command("OUTREDUCEDEVICE NONE", may_lack=True)  # omitted samples would count as lost
    if scaling != distance_words.MASTERED:  # a zero set in the sensor shifts its words
        dialogue.command("MASTERMV NONE", may_lack=True)
    doubts = [
        doubt
        for text, what in (
            ("TRIGGER NONE", "it may wait for a trigger"),
            ("AVERAGE NONE", "its distances may be averaged, thus smoothed and late"),
        )
        if (doubt := dialogue.switch_off(text, what))
    ]
    dialogue.command(f"MEASRATE {config.rate_Hz / 1000:g}")
    dialogue.command("OUTADD_RS422 COUNTER TIMESTAMP")
    words = config.output_words or _output_words(device, dialogue.command("GETOUTINFO_RS422"))
    dialogue.command("OUTPUT RS422")
    if slow := _slow_line(device, config, words):
        doubts.append(slow)
    warning = {"warning": ". ".join(doubts)} if doubts else {}
    return {**info, "scaling": scaling, "words": list(words), **warning}


def _after_stream(device: str, config: Laser, talk: Talk) -> _Dialogue:
    """Stop the stream and return the dialogue once the sensor answers.

    A host that is busy reads the stream of the sensor in portions, and the pause between two of them looks like the end
    of the stream. As long as bytes arrive instead of the answer, which stands behind them, the stop is repeated.

    Raises:
        DeviceError: the sensor goes on streaming, or does not answer.
    """
    give_up_s, repeated = talk.clock.now_s() + _MOST_BACKLOG_S, False
    while True:
        if not stop_stream(talk, b"OUTPUT NONE\n"):
            raise DeviceError(
                f"{device} on {config.port}: sent OUTPUT NONE several times, it goes on streaming. {_why(config, talk)}"
            )
        talk.restart_decoding()
        dialogue, received = _Dialogue(device, config, talk), talk.bytes_in
        try:
            dialogue.command("OUTPUT NONE", repeat=False)  # the answer to the first one may be lost in the stream
        except _NoAnswer:
            if talk.bytes_in == received or talk.clock.now_s() > give_up_s:
                raise
            repeated = True
            continue
        if repeated:
            dialogue.drop_answers(_QUIET_S)  # those to the earlier ones
        return dialogue


def _why(config: Laser, talk: Talk) -> str:
    """Return the likely reason for a stream that does not stop, from the answers received meanwhile."""
    while not talk.replies.empty():
        line = talk.replies.get_nowait()
        if _is_refusal(line) and _ACCESS.search(line):
            return f"It answers {line}. {_USER_LEVEL}"
    return (
        f"Does its line carry commands too (both wire pairs of RS422), is its baud rate {config.baud}, and does "
        "another program or master command it? Switch it off and on"
    )


def _is_refusal(line: str) -> bool:
    return _REFUSAL.match(line) is not None


class _NoAnswer(DeviceError):
    """The sensor did not answer a command in time."""


class _Dialogue:
    """Commands and their answers."""

    def __init__(self, device: str, config: Laser, talk: Talk) -> None:
        self._device, self._config, self._talk = device, config, talk
        self._answered = False
        self._sent = {"OUTPUT"}  # names of the commands so far

    def command(self, text: str, *, may_lack: bool = False, repeat: bool = True) -> list[str]:
        """Send a command and return the lines of the answer.

        If the sensor `may_lack` the command, a refusal and a missing answer are accepted. A refusal of the arguments or
        of the access level is an error in any case. Without an answer the command is sent a second time, unless
        `repeat` is False: an answer may be damaged on the line.
        """
        lines, bad = self._ask(text, repeat=repeat)
        if lines is None:
            if may_lack:
                return []
            raise _NoAnswer(self._no_answer(text, repeat))
        if bad and (not may_lack or _ACCESS.search(bad) or _ARGUMENT.search(bad)):
            raise self._refused(text, bad)
        return lines

    def switch_off(self, text: str, otherwise: str) -> str:
        """Send a command that switches a function off.

        Returns:
            Warning with the consequence `otherwise` if the sensor has the command but refuses it; otherwise empty.
        """
        _, bad = self._ask(text)
        if bad and _ACCESS.search(bad):
            raise self._refused(text, bad)
        return f"{text} refused ({bad}): {otherwise}" if bad and not re.search("unknown command", bad, re.I) else ""

    def _ask(self, text: str, *, repeat: bool = True) -> tuple[list[str] | None, str]:
        """Return the lines of the answer, None without an answer, and the refusal among them; empty without one."""
        self._sent.add(text.split(maxsplit=1)[0])
        for attempt, wait_s in enumerate(_ANSWER_S if repeat else _ANSWER_S[:1]):
            if attempt == 0:
                self.drop_answers(0.0)
            self._talk.send(text.encode("ascii") + b"\n")
            lines = self._answer(text, wait_s)
            if lines is None:
                continue
            self._answered = True
            if attempt:
                self.drop_answers(_QUIET_S)  # the other answer may be late
            return lines, next((line for line in lines if _is_refusal(line)), "")
        return None, ""

    def _answer(self, text: str, wait_s: float) -> list[str] | None:
        """Return the lines before the prompt of the answer to a command; None if it does not arrive in time."""
        clock = self._talk.clock
        lines: list[str] = []
        deadline = clock.now_s() + wait_s
        while (left := deadline - clock.now_s()) > 0:
            try:
                line = self._talk.replies.get(timeout=left)
            except queue.Empty:  # usual: the sensor sends no further line
                break
            if line != sensor_answers.PROMPT:
                lines.append(line)
            elif self._is_of_another(lines, text):
                lines = []
            else:
                return lines
        return None

    def _is_of_another(self, lines: Sequence[str], text: str) -> bool:
        """Whether the lines acknowledge another command: they are the answer of a slow sensor to an earlier one."""
        name = text.split(maxsplit=1)[0]
        found = {match[1].upper() for line in lines if (match := _ACKNOWLEDGED.fullmatch(line))} & self._sent
        return bool(found) and name not in found

    def drop_answers(self, quiet_s: float) -> None:
        """Remove answers until none has arrived for some seconds, or some more have passed."""
        clock = self._talk.clock
        end_s = clock.now_s() + _MOST_LATE_S
        try:
            while clock.now_s() < end_s:
                if quiet_s:
                    self._talk.replies.get(timeout=quiet_s)
                else:
                    self._talk.replies.get_nowait()
        except queue.Empty:  # usual: no further answer
            return

    def _refused(self, text: str, refusal: str) -> DeviceError:
        """Return the error about a refused command, with what concerns this command."""
        name = text.split(maxsplit=1)[0]
        if _ACCESS.search(refusal):
            advice = _USER_LEVEL
        elif name == "MEASRATE":
            rate = f"devices.{self._device}.rate_Hz is {self._config.rate_Hz:g}"
            advice = f"{rate}: set a rate of its model, in Hz (its manual: MEASRATE, in kHz)"
        elif name.endswith("_RS422"):
            advice = "Distance, counter and timestamp are needed: does its firmware have this command and these values?"
        else:
            advice = "Samples could be omitted or shifted: look at this setting on its web page, and repeat this"
        return DeviceError(f"{self._device}: {text!r} refused: {refusal}. {advice}")

    def _no_answer(self, text: str, repeat: bool) -> str:
        waited = f"{sum(_ANSWER_S):g} s, although it was sent twice" if repeat else f"{_ANSWER_S[0]:g} s"
        advice = (
            "It answered earlier commands: look at the cable, its shield and the adapter, and repeat this"
            if self._answered
            else f"Is the baud rate {self._config.baud} and the sensor powered?"
        )
        return f"{self._device} on {self._config.port}: no answer to {text!r} within {waited}. {advice}"


def _slow_line(device: str, config: Laser, words: Sequence[str]) -> str:
    """Return a warning if the stated baud rate does not carry the stream; otherwise empty."""
    needed = len(words) * _BITS_PER_WORD * config.rate_Hz
    if needed <= config.baud:
        return ""
    most = config.baud / (len(words) * _BITS_PER_WORD)
    return (
        f"{number_of(len(words), 'output word')} at {config.rate_Hz:g} Hz need {needed:.0f} baud, "
        f"devices.{device}.baud is {config.baud}: "
        "the sensor sends error codes instead of distances then. Set a rate of its model up to "
        f"{most:.0f} Hz, or a higher baud rate in sensor and rig file"
    )


def _info(device: str, answer: Sequence[str]) -> sensor_answers.SensorInfo:
    """Return the contents of an answer to GETINFO.

    Raises:
        DeviceError: the measuring range is missing.
    """
    try:
        return sensor_answers.parse_info(answer)
    except DeviceError as error:
        raise DeviceError(f"{device}: {error}") from error


def _checked_scaling(device: str, config: Laser, info: sensor_answers.SensorInfo) -> str:
    """Return the scaling of the sensor.

    Raises:
        DeviceError: the sensor has another range than the rig file, or its scaling is unknown.
    """
    compare_range(device, config, info["range_m"], info["serial"])
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
    announced = [sensor_answers.named(answer), *map(sensor_answers.announced, answer)]
    readable = [words for words in announced if words is not None and sensor_answers.places_of(words) is not None]
    if not readable:
        raise DeviceError(
            f"{device}: expected distance, counter and timestamp among its output words, got {list(answer)!r:.200} in "
            "answer to GETOUTINFO_RS422: does its firmware have OUTADD_RS422 COUNTER TIMESTAMP? If these words are in "
            f"its stream by other names, set devices.{device}.words, in stream order"
        )
    return readable[-1]


_WORDS = ("DIST",)  # answers are found between blocks of any number of words
_RATE = re.compile(r"MEASRATE\s+(\d+(?:\.\d+)?)(?:\s*KHZ)?", re.IGNORECASE)


def identity_turns(settings: Laser) -> IdentityTurns:
    """Query name, serial number, range and measuring rate: `GETINFO` and `MEASRATE` without an argument.

    Source: ILD1420 manual, ASCII commands. The line feed before the first command ends a line that another program
    or another request has begun.
    """
    info = _lines((yield IdentityRequest(b"\nGETINFO\n", partial(_contains, b"Measuring range"))))
    try:
        found = sensor_answers.parse_info(info)
    except DeviceError:  # usual: another device, or none
        return None
    rate = next((m for line in _lines((yield _rate_request())) if (m := _RATE.match(line))), None)
    known = {"range_m": found["range_m"], "baud": settings.baud}
    if rate is not None:
        known["rate_Hz"] = float(rate[1]) * 1e3
    return FoundDevice(known, {key: found[key] for key in ("name", "serial", "version") if found[key]})


def _rate_request() -> IdentityRequest:
    return IdentityRequest(b"MEASRATE\n", partial(_contains, b"MEASRATE"))


def _lines(data: bytes) -> list[str]:
    """Return the lines of text in received bytes; a stream may be between them."""
    return BlockDecoder(_WORDS).feed(data).text


def _contains(key: bytes, data: bytes) -> bool:
    """Whether the answer with a key is complete: the prompt follows it."""
    at = data.find(key)
    return at >= 0 and sensor_answers.PROMPT.encode() in data[at:]
