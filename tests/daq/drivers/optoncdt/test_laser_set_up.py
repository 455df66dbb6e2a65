"""Set-up of a sensor that an earlier session or a weak line left in an unusual state."""

from __future__ import annotations

import queue

import numpy as np
import pytest

from daq.drivers.optoncdt import dialogue, wire as optoncdt
from daq.drivers.optoncdt.settings import Laser
from daq.drivers.optoncdt.stream import LaserPipeline
from daq.errors import DeviceError
from daq.items import RX
from daq.transports.host_clock import HostClock
from rig_configs import load_rig
from tests.daq.hand_made_laser import HandMadeLaser

NOT_IN_EVERY_MODEL: list[str] = ["TRIGGER", "AVERAGE", "OUTHOLD", "OUTREDUCEDEVICE", "MASTERMV"]
WORDS = ["DIST", "COUNTER", "TIMESTAMP_LO", "TIMESTAMP_HI"]


class WeakLine(HandMadeLaser):
    """A sensor some of whose answers are lost or late.

    Args:
        lost: number of lost answers, by command.
        late: commands whose answer arrives only with that to the next command.
    """

    def __init__(self, lost: dict[str, int] | None = None, late: tuple[str, ...] = ()) -> None:
        super().__init__()
        self._lost, self._late = lost or {}, set(late)
        self._held: list[str] = []

    def send(self, data: bytes) -> None:
        before = self.replies.qsize()
        super().send(data)
        answer = [self.replies.get_nowait() for _ in range(self.replies.qsize())][before:]
        command = data.decode().strip()
        if self._lost.get(command, 0) > 0:
            self._lost[command] -= 1
        elif command in self._late:
            self._late.discard(command)
            self._held = answer
        else:
            for line in [*self._held, *answer]:
                self.replies.put(line)
            self._held = []


def test_trigger_and_averaging_of_an_earlier_session_are_switched_off() -> None:
    sensor = HandMadeLaser()
    identity = sensor.set_up()
    assert {"TRIGGER NONE", "AVERAGE NONE"} <= {*sensor.heard}
    assert sensor.heard[-1] == "OUTPUT RS422"
    assert "warning" not in identity


def test_a_sensor_without_these_commands_is_accepted() -> None:
    lacks = dict.fromkeys(NOT_IN_EVERY_MODEL, "E210 Unknown command")
    assert "warning" not in HandMadeLaser(answers=lacks).set_up()


def test_averaging_that_cannot_be_switched_off_is_a_warning() -> None:
    identity = HandMadeLaser(answers={"AVERAGE": "E230 Unknown parameter"}).set_up()
    assert identity["warning"] == (
        "AVERAGE NONE refused (E230 Unknown parameter): its distances may be averaged, thus smoothed and late"
    )


@pytest.mark.parametrize("command", ["OUTPUT", "AVERAGE", "MEASRATE"])
def test_a_refusal_by_the_user_level_names_the_remedy(command: str) -> None:
    sensor = HandMadeLaser(answers={command: "E202 Access denied"})
    with pytest.raises(DeviceError, match=rf"'{command} .* refused: E202 Access denied\. .* LOGIN .* STDUSER PROF"):
        sensor.set_up()


def test_a_stream_that_the_user_level_protects_names_the_remedy(monkeypatch: pytest.MonkeyPatch) -> None:
    sensor = HandMadeLaser(answers={"OUTPUT NONE": "E202 Access denied"})

    def goes_on(talk: HandMadeLaser, order: bytes) -> bool:
        talk.send(order)
        return False

    monkeypatch.setattr(dialogue, "stop_stream", goes_on)
    with pytest.raises(DeviceError, match=r"goes on streaming\. It answers E202 .* STDUSER PROFESSIONAL"):
        sensor.set_up()


@pytest.mark.parametrize("command", ["GETINFO", "MEASRATE 4", "GETOUTINFO_RS422", "OUTPUT RS422"])
def test_a_lost_answer_is_requested_again(command: str) -> None:
    sensor = WeakLine(lost={command: 1})
    assert sensor.set_up()["words"] == WORDS
    assert sensor.heard.count(command) == 2


@pytest.mark.parametrize("command", ["ECHO ON", "GETINFO", "MASTERMV NONE", "MEASRATE 4", "GETOUTINFO_RS422"])
def test_a_late_answer_is_not_taken_for_that_to_the_next_command(command: str) -> None:
    sensor = WeakLine(late=(command,))
    assert sensor.set_up()["words"] == WORDS


class SlowLaser(HandMadeLaser):
    """A sensor that answers each command 40 ms late."""

    def send(self, data: bytes) -> None:
        before = self.replies.qsize()
        super().send(data)
        lines = [self.replies.get_nowait() for _ in range(self.replies.qsize())]
        for line in lines[:before]:
            self.replies.put(line)
        self.clock.after(0.04, lambda: [self.replies.put(line) for line in lines[before:]])


def test_an_answer_to_an_earlier_command_is_not_taken_for_that_to_this_one(monkeypatch: pytest.MonkeyPatch) -> None:
    """The answers to the commands that stop its stream arrive after the next commands have been sent."""
    monkeypatch.setattr("daq.drivers.questions._QUIET_S", 0.001)
    identity = SlowLaser().set_up()
    assert (identity["serial"], identity["words"]) == ("12345678", WORDS)
    assert "warning" not in identity


def test_a_line_that_ends_like_an_acknowledgement_is_part_of_its_answer() -> None:
    info = "Name: ILD1420-25\r\nSerial: 12345678\r\nMeasuring range: 25.00mm\r\nSelf test: ok"
    assert HandMadeLaser(answers={"GETINFO": info}).set_up()["serial"] == "12345678"


def test_an_echo_before_a_refusal_does_not_hide_it() -> None:
    sensor = HandMadeLaser(answers={"MEASRATE": "MEASRATE\r\nE208 Out of range"})
    with pytest.raises(DeviceError, match="'MEASRATE 4' refused: E208"):
        sensor.set_up()


def test_a_sensor_without_the_echo_command_is_accepted() -> None:
    assert HandMadeLaser(answers={"ECHO": "E201 Unknown command"}).set_up()["words"] == WORDS


@pytest.mark.parametrize(
    ("command", "advice"),
    [
        ("MEASRATE", r"devices\.laser_x\.rate_Hz is 3000: set a rate of its model"),
        ("OUTADD_RS422", r"does its firmware have this command and these values"),
        ("OUTHOLD", r"look at this setting on its web page"),
    ],
)
def test_a_refusal_states_what_concerns_this_command(command: str, advice: str) -> None:
    sensor = HandMadeLaser(answers={command: "E208 Parameter out of range"})
    with pytest.raises(DeviceError, match=rf"laser_x: '{command} .* refused: E208 .*{advice}"):
        sensor.set_up(rate_Hz=3000)


def test_a_stream_that_does_not_stop_may_have_another_baud_rate(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(dialogue, "stop_stream", lambda *_: False)
    with pytest.raises(DeviceError, match=r"laser_x on p: .* goes on streaming\. .* is its baud rate 115200"):
        HandMadeLaser().set_up(baud=115_200)


@pytest.mark.parametrize("line", ["Messbereich: 25,00mm", "Measuring range: 25.00 mm", "Range: 25mm", "MR: 25.0 MM"])
def test_the_range_is_read_from_the_only_line_in_millimetres(line: str) -> None:
    info = f"Name: ILD1420-25\r\nSerial: 12345678\r\n{line}\r\nVersion: 001.005"
    assert HandMadeLaser(answers={"GETINFO": info}).set_up()["range_m"] == 0.025


@pytest.mark.parametrize("lines", ["", "\r\nMessbereich: 25,00mm\r\nOffset: 3.00mm", "\r\nMessbereich: 0mm"])
def test_a_range_that_is_missing_or_not_the_only_one_is_refused_with_the_device(lines: str) -> None:
    with pytest.raises(DeviceError, match="laser_x: expected a line like 'Measuring range"):
        HandMadeLaser(answers={"GETINFO": f"Name: ILD1420-25{lines}"}).set_up()


@pytest.mark.parametrize("name", ["ILD2300", "ILD2300-20LL"])
def test_an_ild2300_without_samples_is_explained_by_its_short_timestamp(name: str) -> None:
    identity = HandMadeLaser(name=name).set_up()
    assert identity["scaling"] == "ILD1420"
    laser = load_rig("virtual").devices["laser_x"]
    pipeline = LaserPipeline("laser_x", laser, identity)
    assert all(words in pipeline.status.complaint for words in ("one value", "by Ethernet", "devices.laser_x.words"))
    assert pipeline.status.has_reported
    other = LaserPipeline("laser_x", laser, {**identity, "name": "ILD1420-25"})
    assert other.status.complaint == ""
    rows = np.column_stack([np.full(40, 30_000), np.arange(40), 25 * np.arange(40), np.zeros(40, int)])
    pipeline.feed(RX, optoncdt.encode_block(rows), 1_700_000_000_000_000_000)
    assert pipeline.status.complaint == "", "two values are decoded as with other models"


def test_two_lost_answers_end_the_set_up_with_what_to_look_at() -> None:
    sensor = WeakLine(lost={"MEASRATE 4": 2})
    with pytest.raises(DeviceError, match=r"no answer to 'MEASRATE 4' .* It answered earlier commands: look at the"):
        sensor.set_up()
    assert "OUTPUT RS422" not in sensor.heard


def test_a_rate_beyond_the_line_is_a_warning_with_the_highest_possible() -> None:
    warning = HandMadeLaser().set_up(rate_Hz=8000)["warning"]
    assert "4 output words at 8000 Hz need 960000 baud, devices.laser_x.baud is 921600" in warning
    assert "up to 7680 Hz" in warning
    assert "warning" not in HandMadeLaser().set_up(rate_Hz=8000, baud=1_000_000)


@pytest.mark.parametrize(
    "answer",
    [
        "DIST1 COUNTER TIMESTAMP",
        "DIST1, COUNTER, TIMESTAMP",
        "GETOUTINFO_RS422: DIST1 COUNTER TIMESTAMP",
        "GETOUTINFO_RS422\r\nDIST COUNTER TIMESTAMP",
        "GETOUTINFO_RS422 ok\r\nDIST1\r\nCOUNTER\r\nTIMESTAMP_LO\r\nTIMESTAMP_HI",
        "W100 something\r\nDIST1 COUNTER TIMESTAMP",
    ],
)
def test_output_names_without_the_commands_name_are_read(answer: str) -> None:
    assert HandMadeLaser(outinfo=answer).set_up()["words"] == WORDS


class Talkative(queue.Queue[str]):
    """Replies of a sensor that sends a line of text each millisecond, without end."""

    def __init__(self, clock: HostClock) -> None:
        super().__init__()
        self._clock = clock

    def get(self, block: bool = True, timeout: float | None = None) -> str:
        self._clock.wait(1e-3)
        return "1. DIST1"

    def empty(self) -> bool:
        return False


def test_lines_without_end_after_a_repeated_command_are_not_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(dialogue, "_MOST_LATE_S", 0.05)
    sensor = HandMadeLaser()
    sensor.replies = Talkative(sensor.clock)
    asked = dialogue._Dialogue("x", Laser.model_validate({"driver": "optoncdt", "port": "p", "axis": "x"}), sensor)
    begun_s = sensor.clock.now_s()
    asked.drop_answers(0.02)
    asked.drop_answers(0.0)
    assert sensor.clock.now_s() - begun_s < 2.0
