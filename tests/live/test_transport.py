"""Play, pause, seek and speed of a log, on a clock that the test moves."""

import math

import pytest

from live.transport import Transport


class Clock:
    def __init__(self) -> None:
        self.now = 1000.0

    def __call__(self) -> float:
        return self.now


def made(speed: float = 1.0) -> tuple[Transport, Clock]:
    clock = Clock()
    return Transport(0.0, 40.0, speed, clock), clock


def test_it_plays_at_its_speed_to_the_end() -> None:
    transport, clock = made(2.0)
    clock.now += 5
    assert transport.at() == 10.0
    assert transport.playing
    clock.now += 100
    assert transport.at() == 40.0
    assert not transport.playing


def test_a_pause_stands_and_play_goes_on_from_there() -> None:
    transport, clock = made()
    clock.now += 3
    transport.pause()
    clock.now += 50
    assert transport.at() == 3.0
    assert not transport.playing
    transport.play()
    transport.play()
    clock.now += 1
    assert transport.at() == 4.0


def test_play_at_the_end_begins_again() -> None:
    transport, clock = made()
    clock.now += 41
    transport.play()
    clock.now += 2
    assert transport.at() == 2.0


def test_it_waits_for_the_first_viewer_and_for_no_other() -> None:
    transport, clock = made()
    transport.await_viewer()
    clock.now += 50
    assert transport.at() == 0.0
    assert not transport.playing
    transport.looked_at()
    clock.now += 2
    assert transport.at() == 2.0
    transport.pause()
    transport.looked_at()
    clock.now += 2
    assert transport.at() == 2.0, "paused by hand: the next viewer does not start it"


@pytest.mark.parametrize("paused", [True, False])
def test_seek_goes_there_and_keeps_playing_or_standing(paused: bool) -> None:
    transport, clock = made()
    if paused:
        transport.pause()
    transport.seek(20.0)
    clock.now += 1
    assert transport.at() == (20.0 if paused else 21.0)
    transport.seek(-5.0)
    assert transport.at() == 0.0
    transport.seek(1e9)
    assert transport.at() == 40.0


def test_a_new_speed_does_not_move_the_instant() -> None:
    transport, clock = made()
    clock.now += 10
    transport.set_speed(0.5)
    assert transport.at() == 10.0
    clock.now += 10
    assert transport.at() == 15.0
    assert transport.speed == 0.5


@pytest.mark.parametrize("speed", [0.0, -1.0, 1e6, math.nan, math.inf])
def test_an_invalid_speed_is_refused(speed: float) -> None:
    transport, _ = made()
    with pytest.raises(ValueError, match="expected a speed"):
        transport.set_speed(speed)
    with pytest.raises(ValueError, match="expected an instant"):
        transport.seek(math.nan)
