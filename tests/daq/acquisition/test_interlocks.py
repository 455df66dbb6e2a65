"""Interlocks: faults of the virtual rig's far ends, decoded by the real pipelines, without clock and waits."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator

import numpy as np
import pytest
from hypothesis import given, settings as hypothesis_settings, strategies as st

from daq import channels
from daq.acquisition.channel_watch import ChannelWatch
from daq.acquisition.interlocks import Interlocks, Share, Stop
from daq.acquisition.least_motion import LeastMotion
from daq.acquisition.rotor_watch import RotorWatch
from daq.items import Batch
from rig_configs import load_rig
from tests.daq.acquisition.test_interlock_table import hangs_with_its_neighbour, nothing
from tests.daq.far_ends import START_NS, Bench


def test_a_rig_without_faults_is_not_stopped_and_no_channel_is_silent() -> None:
    with Bench() as bench:
        bench.turn(900)
        bench.pass_time(2.0)
        bench.quick_stop()
        bench.pass_time(2.0)
        assert bench.stops == []
        assert bench.events == []
        assert bench.interlocks.losses(bench.now_ns) == {}
        assert bench.interlocks.at_rest(bench.now_ns) is True


FAILURES = [
    # device, what, value, seconds in which the rotor must be stopped, words
    ("encoder", "dead", 1, 2.0, "pendulums: silent"),
    ("laser_x", "code", 262076, 0.5, r"laser/x: most samples .*invalid .*code 262076"),
    ("laser_y", "code", 262075, 0.5, "laser/y: most samples"),
    ("laser_y", "code", 262080, 0.5, "laser/y: most samples"),
    ("laser_x", "code", 33_000, 0.8, r"laser/x: reads .* without any change for 0\.. s"),
    ("laser_y", "code", 32_760, 0.8, "laser/y: reads .* the sensor hangs"),
    ("encoder", "flags", 1, 0.4, "pendulums: the node reports a fault of encoder A"),
    ("encoder", "flags", 2, 0.4, "fault of encoder B"),
    ("encoder", "marks lost", 1, 3.0, "tacho: no index mark for"),
    ("drive", "restart", 1, 0.1, r"drive: the drive started again \(boot-up"),
    ("drive", "network", 0x04, 0.3, "drive: network state STOPPED"),
    ("drive", "network", 0x7F, 0.3, "drive: network state PRE-OPERATIONAL"),
    ("drive", "silent reports", 1, 1.0, "motor: silent"),
    ("drive", "reported share", 0.5, 3.0, "the index marks come at 5.. rpm, the drive reports"),
    ("drive", "reported share", 2.2, 4.0, "the drive reports .* rpm, (600 rpm were commanded|limits)"),
    ("drive", "speed", 1100, 2.0, "the drive reports .* rpm, 600 rpm were commanded"),
    *((device, "mute", 1, 2.0, "silent") for device in ("laser_x", "laser_y", "drive", "encoder")),
]


@pytest.mark.parametrize(("device", "what", "value", "within_s", "words"), FAILURES)
def test_each_failure_of_a_guard_stops_a_turning_rotor(
    device: str, what: str, value: float, within_s: float, words: str
) -> None:
    with Bench() as bench:
        bench.turn(600)
        assert bench.stops == []
        bench.muted.add(device) if what == "mute" else bench.fails(device, what, value)
        assert bench.pass_time(within_s + 1.0, until_stop=True) <= within_s
        assert bench.stops
        assert re.search(words, bench.why()), bench.why()


def is_suspended(bench: Bench) -> None:
    """No read and no tick for 1.2 s, then all bytes arrive together."""
    bench.now_s += 1.2


def pauses(bench: Bench) -> None:
    """Ticks continue, and no device sends anything."""
    bench.muted |= set(bench.pipelines)
    bench.pass_time(1.2)
    bench.muted.clear()


def is_flashed_at(bench: Bench) -> None:
    for _ in range(5):
        bench.fails("laser_x", "code", 262076)
        bench.pass_time(0.08)
        bench.fails("laser_x", "code", 0)
        bench.pass_time(0.2)


NO_NOISE = ("virtual.sensors.laser_noise_m=0", "virtual.sensors.encoder_noise_counts=0")


@pytest.mark.parametrize(
    ("happens", "rpm", "settings"),
    [
        (is_suspended, 600, ()),
        (pauses, 600, ()),
        (is_flashed_at, 600, ()),
        (hangs_with_its_neighbour, 600, ("imbalance.mass_kg=0",)),  # a balanced rotor
        *((nothing, rpm, NO_NOISE) for rpm in (60, 300, 900)),
    ],
)
def test_what_is_no_failure_of_a_guard_stops_nothing(
    happens: Callable[[Bench], None], rpm: int, settings: tuple[str, ...]
) -> None:
    with Bench(*settings) as bench:
        bench.turn(rpm)
        happens(bench)
        bench.pass_time(3.0)
        assert bench.stops == []
        assert not [event for event in bench.events if event.kind == "silence"]


def test_a_rig_that_is_silent_as_a_whole_stops_the_rotor() -> None:
    with Bench() as bench:
        bench.turn(600)
        bench.muted |= set(bench.pipelines)
        silent_s = bench.pass_time(5.0, until_stop=True)
        assert 1.5 < silent_s <= 3.0
        (found,) = set(re.findall(r"silent for (\d\.\d) s", bench.why()))
        assert float(found) == pytest.approx(silent_s, abs=0.15)  # not relative to the other silent channels


def test_at_rest_a_covered_sensor_is_an_event_and_not_a_stop() -> None:
    with Bench() as bench:
        bench.fails("laser_x", "code", 262076)
        bench.pass_time(3.0)
        bench.fails("laser_x", "code", 0)
        bench.pass_time(1.0)
        assert bench.stops == []
        assert [(e.kind, e.facts["of"]) for e in bench.events] == [("blind", "laser_x")] * 2


@pytest.mark.parametrize(
    ("device", "what", "value"), [("laser_x", "code", 262076), ("encoder", "flags", 1), ("encoder", "dead", 1)]
)
def test_a_rotor_is_not_turned_while_a_guard_is_missing(device: str, what: str, value: int) -> None:
    with Bench() as bench:
        assert bench.interlocks.obstacles(bench.now_ns) == []
        bench.fails(device, what, value)
        bench.pass_time(2.0)
        assert len(bench.interlocks.obstacles(bench.now_ns)) == 1


def test_at_rest_only_what_the_test_needs_ends_it() -> None:
    for needed, stopped in (("laser/x", False), ("pendulums", True)):
        with Bench() as bench:
            bench.interlocks.need([needed])
            bench.fails("encoder", "dead")
            bench.pass_time(4.0)
            assert bool(bench.stops) == stopped
            assert [e.kind for e in bench.events] == ["silence"]
        with Bench() as bench:
            bench.interlocks.need([needed])
            bench.fails("encoder", "flags", 2)
            bench.pass_time(1.0)
            assert bool(bench.stops) == stopped


def test_a_lock_that_reports_a_fault_ends_the_test() -> None:
    with Bench() as bench:
        bench.fails("encoder", "locks stuck")
        bench.node._lock_event(bench.now_s, 1, 3, 7)
        bench.pass_time(0.2)
        assert "pendulum B fault" in bench.why()


def test_a_silence_is_counted_continuously_and_has_an_event_at_both_ends() -> None:
    with Bench() as bench:
        bench.fails("encoder", "dead")
        bench.pass_time(10.0)
        lasting = bench.interlocks.losses(bench.now_ns)["encoder"]["pendulums_silent_ms"]
        assert 9_900 < lasting <= 10_050
        bench.fails("encoder", "dead", 0)
        bench.pass_time(1.0)
        begun, ended = bench.events
        assert (begun.kind, begun.device, begun.facts["of"]) == ("silence", "host", "encoder")
        assert ended.facts["pendulums_silent_ms"] == pytest.approx(10_000, abs=60)
        assert ended.facts["span_s"] == pytest.approx(10.0, abs=0.06)
        after = bench.interlocks.losses(bench.now_ns)
        bench.pass_time(1.0)
        assert bench.interlocks.losses(bench.now_ns) == after
        bench.interlocks.begin(bench.now_ns)
        assert bench.interlocks.losses(bench.now_ns) == {}


def test_a_silence_ends_with_its_log_and_is_reported_again_in_the_next() -> None:
    with Bench() as bench:
        bench.turn(300)
        bench.fails("encoder", "dead")
        bench.pass_time(5.0)
        silent = {e.facts["channel"] for e in bench.events}
        assert silent == {"pendulums", "tacho"}
        ended = bench.interlocks.end(bench.now_ns)
        assert {e.facts["channel"] for e in ended} == {"pendulums", "tacho"}
        assert all("as the log ends" in e.text for e in ended)
        bench.interlocks.begin(bench.now_ns)
        bench.pass_time(2.0)
        assert 1_900 < bench.interlocks.losses(bench.now_ns)["encoder"]["pendulums_silent_ms"] <= 2_050


# --- rest --------------------------------------------------------------------------------------------------------


def test_a_reported_speed_of_zero_is_rejected_while_the_rotor_coasts() -> None:
    with Bench() as bench:
        bench.turn(300)
        bench.fails("drive", "reported share", 0.0)
        bench.fails("drive", "fault", 0x3220)
        bench.pass_time(3.0)
        assert bench.interlocks.at_rest(bench.now_ns) is False
        assert bench.interlocks.speed_rpm(bench.now_ns) == pytest.approx(bench.drive.speed_rpm, rel=0.2)
        bench.pass_time(20.0)  # it has run down meanwhile
        assert bench.interlocks.at_rest(bench.now_ns) is True


def test_without_reports_of_the_drive_the_index_marks_decide_about_rest() -> None:
    with Bench() as bench:
        bench.turn(300)
        bench.fails("drive", "restart")
        bench.pass_time(2.0)
        assert np.isnan(bench.interlocks.rotor.drive_rpm(bench.now_ns))
        assert bench.interlocks.at_rest(bench.now_ns) is False
        bench.pass_time(20.0)
        assert bench.drive.speed_rpm == 0
        assert bench.interlocks.at_rest(bench.now_ns) is True
        bench.fails("encoder", "dead")
        bench.pass_time(3.0)
        assert bench.interlocks.at_rest(bench.now_ns) is None  # no source is available


def test_a_report_that_is_too_old_is_not_used() -> None:
    with Bench() as bench:
        bench.fails("drive", "silent reports")
        bench.pass_time(1.0)
        assert np.isnan(bench.interlocks.speed_rpm(bench.now_ns))
        assert bench.interlocks.at_rest(bench.now_ns) is True  # it stood, and no index mark has come since
        assert "the drive is silent" in bench.interlocks.rotor_words(bench.now_ns)
        bench.pass_time(3.0)
        assert bench.interlocks.at_rest(bench.now_ns) is True
        assert bench.stops == []
        bench.fails("drive", "silent reports", 0)
        bench.pass_time(0.5)
        assert bench.interlocks.speed_rpm(bench.now_ns) == 0
        bench.fails("drive", "silent reports")
        bench.pass_time(1.0)
        bench.far.motion._rotor[1] = bench.far.motion._rotor[2] = 20.0  # a push
        bench.pass_time(1.0)
        assert bench.interlocks.at_rest(bench.now_ns) is False, "a mark has come"


def test_a_rotor_turned_by_hand_with_the_drive_at_rest_is_not_guarded() -> None:
    with Bench() as bench:
        bench.fails("drive", "reported share", 0.0)
        bench.far.motion._rotor[1] = bench.far.motion._rotor[2] = 10.0  # a push; it runs down by itself
        bench.fails("laser_x", "code", 262076)
        bench.pass_time(2.0)
        assert bench.interlocks.at_rest(bench.now_ns) is False
        assert bench.stops == []


def test_a_drive_that_restarts_at_rest_is_at_rest() -> None:
    with Bench() as bench:
        bench.fails("drive", "restart")
        bench.pass_time(4.0)
        assert bench.interlocks.at_rest(bench.now_ns) is True


def watched(
    watch: RotorWatch, seconds: float, rpm: Callable[[float], float], marks_s: list[float], delay_s: float = 0.0
) -> Iterator[tuple[float, int]]:
    """Feed a watch every 10 ms with the drive's report and with index marks; yield time, s, and host time, ns.

    Args:
        rpm: speed that the drive reports at a time, NaN for a report without one.
        marks_s: times of the index marks, ascending.
        delay_s: time after which each arrives.
    """
    turns = 0
    for k in range(round(100 * seconds)):
        time_s, now = 0.01 * k, START_NS + k * 10_000_000
        watch.node_heard(now)
        while turns < len(marks_s) and marks_s[turns] + delay_s <= time_s:
            at = np.array([START_NS + round(marks_s[turns] * 1e9)])
            watch.marks_received(now, at, at, np.array([turns]))
            turns += 1
        watch.drive_reported(now, np.array([rpm(time_s)]))
        yield time_s, now


MOTIONS = st.lists(st.tuples(st.integers(-1100, 1100), st.integers(1, 80)), min_size=1, max_size=8)


@hypothesis_settings(max_examples=15)
@given(MOTIONS, st.integers(1, 40), st.floats(0, 0.03), st.floats(0, 0.2))
def test_a_drive_that_follows_its_commands_is_not_a_runaway(
    orders: list[tuple[int, int]], rows: int, noise: float, lag: float
) -> None:
    """Any commands, ramps and division into reads, with noise and overshoot: a drive that follows is not stopped."""
    rng = np.random.default_rng(rows)
    watch = RotorWatch(1200.0)
    now, speed = 0, 0.0
    for target, steps in orders:
        watch.commanded(float(target))
        for _ in range(steps):
            out = []
            for _ in range(rows):
                speed += float(np.clip(target - speed, -4.0, 4.0))
                out.append(speed * (1 + noise * rng.uniform(-1, 1)))
            now += rows * 10_000_000
            assert watch.drive_reported(now, np.array(out)) is None


@pytest.mark.parametrize(("rest_rpm", "stands"), [(1.0, False), (3.0, True)])
def test_reported_speeds_up_to_the_rig_file_s_limit_are_rest(rest_rpm: float, stands: bool) -> None:
    watch = RotorWatch(1200.0, rest_rpm=rest_rpm)
    for k in range(100):
        watch.drive_reported(k * 10_000_000, np.array([2.0 * (-1) ** k]))
    assert watch.at_rest(100 * 10_000_000) is stands
    assert watch.drive_reported(10**9, np.array([4.0])) is None
    assert watch.at_rest(10**9) is False


@pytest.mark.parametrize("delay_s", [0.0, 0.3, 0.8])
def test_a_report_that_jumps_to_rest_does_not_override_index_marks(delay_s: float) -> None:
    """A drive without an encoder reports 0 rpm as soon as it is off, while the rotor coasts at 1000 rpm."""
    watch = RotorWatch(1300.0)
    watch.commanded(1000.0)
    marks_s = np.arange(0.0, 5.0, 0.06).tolist()
    steps = watched(watch, 8.0, lambda time_s: 1000.0 if time_s < 3 else 0.0, marks_s, delay_s)
    at_rest = [time_s for time_s, now in steps if watch.at_rest(now)]
    assert 5.0 < at_rest[0] < 7.0


def test_a_braked_rotor_is_at_rest_as_soon_as_the_drive_reports_it() -> None:
    watch = RotorWatch(1300.0)
    watch.commanded(0.0)
    angle = [1000.0 / 60 * (t - 0.5 * t * t) for t in np.arange(0.0, 1.0, 0.001)]
    marks_s = [0.001 * int(np.searchsorted(angle, turn)) for turn in range(int(angle[-1]))]
    for time_s, now in watched(watch, 3.0, lambda time_s: max(0.0, 1000.0 - 1000.0 * time_s), marks_s):
        assert watch.at_rest(now) is (time_s > 1.095)


@given(st.integers(-1000, 1000), st.sampled_from([-1, 1]))
def test_a_drive_beyond_its_command_or_in_reverse_is_a_runaway(target: int, sign: int) -> None:
    watch = RotorWatch(1200.0)
    watch.commanded(float(target))
    way = sign if sign * target >= 0 else -sign
    speeds = np.arange(0.0, 1.1 * abs(target) + 60.0, 2.0) * way
    assert any(watch.drive_reported(k * 10_000_000, speeds[k : k + 1]) is not None for k in range(len(speeds)))
    other = RotorWatch(1200.0)
    other.commanded(float(abs(target)))
    assert any(other.drive_reported(k * 10_000_000, np.array([-2.0 * k])) is not None for k in range(40))


@given(st.lists(st.tuples(st.integers(1, 60), st.floats(0, 1)), min_size=1, max_size=60))
def test_the_share_of_bad_samples_is_that_of_the_newest_stretch(reads: list[tuple[int, float]]) -> None:
    rng = np.random.default_rng(len(reads))
    share, times, bad = Share(0.25), np.empty(0, int), np.empty(0, bool)
    start = 0
    for count, level in reads:
        new = start + np.arange(count) * 1_000_000
        mask = rng.random(count) < level
        share.add(new, mask)
        times, bad, start = np.concatenate([times, new]), np.concatenate([bad, mask]), start + count * 1_000_000
        good = np.flatnonzero(~bad)
        assert share.in_a_row == len(bad) - 1 - (int(good[-1]) if len(good) else -1)
        if share.mostly_bad:  # must not be true if the newest quarter of a second is mostly good
            assert times[-1] - times[0] >= 0.2e9
            assert np.count_nonzero(bad[times > times[-1] - 320_000_000]) > 0
        if len(bad) >= 400 and bad[-400:].all():
            assert share.mostly_bad


@given(st.lists(st.tuples(st.sampled_from(["a", "b", "c"]), st.integers(1, 900)), max_size=60))
def test_silences_add_up_to_the_time_without_samples(steps: list[tuple[str, int]]) -> None:
    """For any sequence of samples, beginnings and ends alternate, and the events add up to the counts."""
    watch = ChannelWatch({"a": ("one", 0.5), "b": ("one", 1.0), "c": ("two", float("inf"))})
    watch.begin(0, expected=True)
    now, events = 0, []
    for topic, ms in steps:
        for _ in range(ms // 50 + 1):
            now += 50_000_000
            events += watch.tick(now)
        events += [e for e in [watch.heard(topic, now)] if e is not None]
    events += watch.end(now)
    for topic, device in (("a", "one"), ("b", "one"), ("c", "two")):
        own = [e for e in events if e.facts["channel"] == topic]
        assert [("span_s" in e.facts) for e in own] == [bool(i % 2) for i in range(len(own))]
        reported_s = sum(e.facts.get("span_s", 0.0) for e in own)
        counted = watch.losses(now).get(device, {}).get(f"{topic}_silent_ms", 0)
        assert counted == pytest.approx(reported_s * 1e3, abs=1.0)
    assert not any(e.facts["channel"] == "c" for e in events)


@pytest.mark.parametrize("slew", [0.4, 0.5, 2.5])
def test_corrections_of_the_clock_map_do_not_make_the_rotor_too_fast(slew: float) -> None:
    """After a delay of the host the clock map converges slowly, and the mapped times have a wrong rate meanwhile."""
    rig = load_rig("virtual")
    interlocks = Interlocks(rig.limits, rig.roles, LeastMotion.of(rig), driving=True)
    turn_us = 57_200
    found: list[object] = []
    for k in range(1, 60):
        mark = np.array([k])
        time_ns = np.array([10**18 + round(k * turn_us * slew) * 1000])
        columns = {"revolutions": mark, "node_time_us": (mark * turn_us).astype(np.uint64)}
        now_ns = 10**18 + k * turn_us * 1000
        drive = {"speed_rpm": np.array([1049.0]), "status": np.array([0], np.uint32)}
        found += interlocks.feed(Batch(channels.MOTOR, np.array([now_ns]), mark.astype(np.uint32), drive), now_ns)
        found += interlocks.feed(Batch(channels.TACHO, time_ns, mark.astype(np.uint32), columns), now_ns)
    assert [item for item in found if isinstance(item, Stop) and "limits" in item.text] == []
    assert interlocks.rotor.mark_rpm(10**18 + 59 * turn_us * 1000) == pytest.approx(60e6 / turn_us)


def test_marks_that_are_too_fast_by_their_own_clock_are_found() -> None:
    watch = RotorWatch(1200.0)
    k = np.arange(8)
    assert watch.marks_received(10**18, 10**18 + k * 57_200_000, k * 40_000_000, k) is not None


def test_delayed_index_marks_of_a_braked_rotor_are_not_a_fault() -> None:
    """6 turns at 600 rpm in 0.6 s; when their marks have not come a second later, they never will."""
    watch = RotorWatch(1200.0)
    missing = {
        round(time_s, 2): watch.unseen(now)
        for time_s, now in watched(watch, 1.8, lambda time_s: 600.0 if time_s < 0.6 else 0.0, [])
    }
    assert missing[0.6] is None
    assert "no index mark for 6 turns" in str(missing[1.79])


def test_a_report_without_a_speed_is_no_evidence_of_rest() -> None:
    """Its output was switched off at 600 rpm: the index marks decide until they cease."""
    watch, at_rest = RotorWatch(1200.0), list[float]()
    watch.commanded(600.0)
    marks_s = np.arange(0.0, 3.0, 0.1).tolist()
    for time_s, now in watched(watch, 7.0, lambda time_s: 600.0 if time_s < 1.0 else np.nan, marks_s):
        if time_s == 1.2:
            watch.commanded(0.0)
            assert "the drive reports no speed" in watch.words(now)
        assert watch.unseen(now) is None
        if watch.at_rest(now):
            at_rest.append(time_s)
    assert (at_rest[0] > 3.0, at_rest[-1]) == (True, pytest.approx(6.99))
    assert "the drive is silent" in watch.words(now + 5_000_000_000)


def test_a_speed_after_reports_without_one_counts_no_turns_that_were_not_reported() -> None:
    watch, now = RotorWatch(1200.0), START_NS
    watch.commanded(300.0)
    watch.node_heard(now)
    for rpm in (300.0, np.nan, np.nan, 300.0):
        now += 50_000_000
        assert watch.drive_reported(now, np.array([rpm])) is None
        assert watch.unseen(now) is None
    assert watch.drive_reported(now + 50_000_000, np.array([300.0, np.nan])) is None
    assert np.isnan(watch.drive_rpm(now + 50_000_000))
    assert watch.drive_reported(now + 99_000_000, np.array([np.nan, 900.0, 900.0, 900.0, 900.0])) is not None


def test_missing_index_marks_are_not_rest_of_a_rotor_turned_by_hand() -> None:
    watch, now, turn = RotorWatch(1200.0, driven=False), START_NS, 0
    watch.commanded(300.0)
    for _ in range(20):  # 300 rpm
        now, turn = now + 200_000_000, turn + 1
        watch.marks_received(now, np.array([now]), np.array([now]), np.array([turn]))
        assert (watch.at_rest(now), watch.unseen(now)) == (False, None)
    now += 6_000_000_000
    watch.node_heard(now)
    assert watch.at_rest(now) is None  # the index sensor may have failed, so the state is unknown
    assert "no index mark for 6.0 s, the last one at 300 rpm" in (watch.unseen(now) or "")
    watch.commanded(0.0)  # the operator was asked to stop the rotor
    assert (watch.at_rest(now), watch.unseen(now)) == (True, None)
