"""Tests of a driver's pipeline on recorded bytes: replayed, cut differently, damaged, lost, of another device."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable

import numpy as np
from numpy.typing import NDArray

from daq.drivers.contract import Pipeline, SampleClock
from daq.items import RX, Batch, DeviceEvent
from rig_basics.texts import number_of
from rig_testing.bench import Items
from rig_testing.report import Failed, NotTried, need
from rig_testing.sizes import size_of
from rig_testing.subject import Reads, Subject, events, lost, together

_SPLITS = (1, 2, 3, 7, 64)
_SPLIT_READS = 120  # of the tape: these reach every state and are decoded quickly if cut into single bytes
_JOINED_NS = 40_000_000
_SAME_NS = 20_000_000  # by which other cuts may move a sample's time; joined reads move host times themselves
_LONGEST_WRAP_S = 100.0
_CLOCK_WRAPS_S = {"2³² µs": 2**32 * 1e-6, "2³² · 10 µs": 2**32 * 1e-5, "2³² ms": 2**32 * 1e-3, "2¹⁶ ms": 2**16 * 1e-3}
_ENDS = 12
_LAST_READS_NS, _LATE_NS = 60_000_000, 50_000_000
# Reads that lose bytes; short ones count if there are too few long ones.
_LONG_READ_BYTES, _SHORT_READ_BYTES = 12, 6
_FLOOD_BYTES, _MOST_BYTES = 1 << 20, 1 << 19


def check_replay(subject: Subject) -> str:
    """The same bytes give the same samples, events and losses, bit for bit; pipelines share no state."""
    tape = subject.tape
    pipelines = [subject.driver.pipeline("device", subject.settings, tape.identity) for _ in range(2)]
    results: list[Items] = [[], []]
    for read in tape.reads:
        for pipeline, items in zip(pipelines, results, strict=True):
            items.extend(pipeline.feed(*read))
    for pipeline, items in zip(pipelines, results, strict=True):
        difference = _difference(tape.items, items) or _losses_differ(tape.losses, pipeline.losses)
        need(not difference, f"decoded again: {difference}")
    return number_of(sum(isinstance(item, Batch) for item in tape.items), "batch", "batches")


def _difference(first: Items, second: Items) -> str:
    """Return the first difference; empty if all is equal bit for bit."""
    if len(first) != len(second):
        return f"{number_of(len(second), 'batch or event', 'batches and events')}, expected {len(first)}"
    for number, (a, b) in enumerate(zip(first, second, strict=True)):
        if isinstance(a, DeviceEvent) or isinstance(b, DeviceEvent):
            if a != b:
                return f"number {number} is {b!r:.200}, expected {a!r:.200}"
            continue
        for name, one, other in (
            ("channel", a.channel.topic, b.channel.topic),
            ("time_ns", a.time_ns.tobytes(), b.time_ns.tobytes()),
            ("sequence", a.sequence.tobytes(), b.sequence.tobytes()),
            *((field, a.columns[field].tobytes(), b.columns[field].tobytes()) for field in a.columns),
        ):
            if one != other:
                return f"batch {number} of {a.channel.topic} differs in {name}"
    return ""


def _losses_differ(first: dict[str, int], second: dict[str, int]) -> str:
    return "" if first == second else f"losses {second}, expected {first}"


def check_split(subject: Subject) -> str:
    """Samples and losses do not depend on how the bytes are cut into reads."""
    reads = subject.tape.reads[:_SPLIT_READS]
    whole, pipeline = subject.decode(reads)
    rng = np.random.default_rng(7)
    for size in _SPLITS:
        _same(
            subject,
            whole,
            pipeline,
            [part for read in reads for part in _cut(read, size)],
            f"reads of {number_of(size, 'byte')}",
        )
    for _ in range(3):
        parts = [part for read in reads for part in _cut(read, int(rng.integers(1, 40)))]
        _same(subject, whole, pipeline, parts, "reads of other lengths")
    _same(subject, whole, pipeline, _joined(reads), "several reads in one", _SAME_NS + _JOINED_NS)
    return f"{len(_SPLITS) + 4} ways to cut"


def _cut(read: tuple[int, bytes, int], size: int) -> Reads:
    direction, data, host_ns = read
    if direction != RX:
        return [read]
    return [(RX, data[at : at + size], host_ns) for at in range(0, len(data), size)]


def _joined(reads: Reads) -> Reads:
    """Join consecutive reads, as a delayed host receives them."""
    out: list[tuple[int, bytes, int]] = []
    first_ns = 0
    for direction, data, host_ns in reads:
        if out and direction == RX == out[-1][0] and host_ns - first_ns < _JOINED_NS:
            out[-1] = (RX, out[-1][1] + data, host_ns)
        else:
            out.append((direction, data, host_ns))
            first_ns = host_ns
    return out


def _same(subject: Subject, whole: Items, pipeline: Pipeline, parts: Reads, how: str, same_ns: int = _SAME_NS) -> None:
    items, other = subject.decode(parts)
    for topic in subject.channels:
        a, b = together(whole, topic), together(items, topic)
        if a is None or b is None:
            need(a is b, f"{how}: channel {topic} is {'empty' if b is None else 'not empty'}, unlike before")
            continue
        need(
            len(a.time_ns) == len(b.time_ns),
            f"{how}: {number_of(len(b.time_ns), 'sample')} in {topic}, expected {len(a.time_ns)}",
        )
        for name in a.columns:
            equal = np.array_equal(np.asarray(a.columns[name], float), np.asarray(b.columns[name], float), True)
            need(equal, f"{how}: {topic} differs in {name}")
        need(np.array_equal(a.sequence, b.sequence), f"{how}: {topic} differs in its sequence")
        off = int(np.max(np.abs(a.time_ns - b.time_ns)))
        need(off <= same_ns, f"{how}: times in {topic} differ by {off / 1e6:.1f} ms")
    difference = _losses_differ(pipeline.losses, other.losses)
    need(not difference, f"{how}: {difference}")


def check_garbage(subject: Subject) -> str:
    """Garbage between reads is counted, and data after it are decoded as before."""
    tape, rng = subject.tape, np.random.default_rng(11)
    reads: list[tuple[int, bytes, int]] = []
    incoming = [i for i, read in enumerate(tape.reads) if read[0] == RX]
    need(len(incoming) > 30, f"only {number_of(len(incoming), 'read')} came in, too few to put garbage between")
    places = set(rng.choice(incoming[len(incoming) // 10 : -len(incoming) // 3], 12, replace=False).tolist())
    for number, read in enumerate(tape.reads):
        if number in places:
            reads.append((RX, rng.bytes(int(rng.integers(5, 60))), read[2]))
        reads.append(read)
    items, pipeline = subject.decode(reads)
    counted = lost(tape.losses, pipeline.losses)
    need(sum(counted.values()) > 0, "12 bursts of garbage came in, and no loss was counted")
    _goes_on(subject, items)
    return _kinds(counted)


def _goes_on(subject: Subject, items: Items) -> None:
    """Check that the last samples are those of the undisturbed tape."""
    for topic in subject.constant:
        expected, found = subject.rows(subject.tape.items, topic), subject.rows(items, topic)
        count = max(1, len(expected) // 20)
        need(
            len(found) >= count and np.array_equal(expected[-count:], found[-count:], equal_nan=True),
            f"{topic}: the last samples, long after the damage, differ from those of the undisturbed line",
        )


def _kinds(counted: dict[str, int]) -> str:
    return ", ".join(f"{kind} {count}" for kind, count in counted.items())


def check_damage(subject: Subject) -> str:
    """Bytes lost from the middle of reads are counted; exactly, if the driver claims so."""
    tape, rng = subject.tape, np.random.default_rng(13)
    reads = list(tape.reads)
    sizes = [len(data) if direction == RX else 0 for direction, data, _ in reads]
    for least in (_LONG_READ_BYTES, _SHORT_READ_BYTES):
        long_enough = [i for i, size in enumerate(sizes) if size >= least]
        if len(long_enough) > 20:
            break
    else:
        raise NotTried(f"fewer than 20 reads have the {_SHORT_READ_BYTES} bytes that are needed to lose some of them")
    some = rng.choice(long_enough[len(long_enough) // 10 : -len(long_enough) // 3], 12, replace=False)
    for number in map(int, some):
        _, data, host_ns = reads[number]
        size = int(rng.integers(1, min(8, len(data) - 4)))
        at = int(rng.integers(1, len(data) - size - 1))
        reads[number] = RX, data[:at] + data[at + size :], host_ns
    return _counted(subject, reads, "12 times some bytes of a read")


def check_lost_reads(subject: Subject) -> str:
    """Lost whole reads are counted if samples have a clock; exactly, if the driver claims so."""
    if not subject.clocks:
        raise NotTried("its samples have no clock: a missing one cannot be detected")
    tape = subject.tape
    first_ns = tape.reads[0][2]
    away = [(0.8, 0.9), (1.3, 1.33), (1.6, 1.85)]  # s after the beginning
    kept = [r for r in tape.reads if r[0] != RX or not any(a <= (r[2] - first_ns) * 1e-9 < b for a, b in away)]
    return _counted(subject, kept, "reads of 100, 30 and 250 ms")


def _counted(subject: Subject, reads: Reads, what: str) -> str:
    tape = subject.tape
    items, pipeline = subject.decode(reads)
    counted = lost(tape.losses, pipeline.losses)
    need(sum(counted.values()) > 0, f"{what} were lost, and no loss was counted")
    reported = len(events(items)) > len(events(tape.items))
    need(reported, f"{what} were lost: counted ({_kinds(counted)}), but no event reports it")
    _goes_on(subject, items)
    if subject.claims("counts exactly"):
        topics = [clock.topic for clock in subject.clocks]
        missing = sum(len(subject.rows(tape.items, topic)) - len(subject.rows(items, topic)) for topic in topics)
        need(
            missing == counted.get("samples", 0),
            f"{what} were lost: {number_of(missing, 'sample')} of {', '.join(topics)} missing, "
            f"{counted.get('samples', 0)} were "
            "counted, and the driver claims to count exactly",
        )
        return f"{_kinds(counted)}, exactly"
    return _kinds(counted)


def check_end(subject: Subject) -> str:
    """A log may end after any read: samples that wait are given then, once, and none is lost without being counted."""
    if not subject.clocks:
        raise NotTried("its samples have no clock: a missing one cannot be detected")
    reads, largest = subject.tape.reads, 0
    incoming = [number for number, read in enumerate(reads) if read[0] == RX]
    places = np.random.default_rng(19).choice(incoming[len(incoming) // 2 :], min(_ENDS, len(incoming) // 2), False)
    for place in places.tolist():
        log = reads[: place + 1]
        whole, _, _ = _to_the_end(subject, log)
        late_ns = log[-1][2] - _LAST_READS_NS
        late: Reads = [(direction, data, ns + _LATE_NS if ns > late_ns else ns) for direction, data, ns in log]
        missed = max(number for number in incoming if number < place)
        for how, ending, may_miss in (
            ("in time", log, False),
            ("with late reads", late, False),
            ("after a lost read", [read for number, read in enumerate(log) if number != missed], True),
        ):
            items, given, counted = _to_the_end(subject, ending)
            largest = max(largest, given)
            missing = sum(_missing(clock, whole, items, to_the_last=may_miss) for clock in subject.clocks)
            known = missing <= counted or (counted > 0 and not subject.claims("counts exactly"))
            need(
                known,
                f"a log that ends {how}: {number_of(missing, 'sample is', 'samples are')} missing, {counted} "
                f"counted as lost",
            )
    return f"{number_of(len(places), 'log')} cut off; {number_of(largest, 'sample')} given at an end"


def _to_the_end(subject: Subject, log: Reads) -> tuple[Items, int, int]:
    """Return all items of a log, the number of samples that its end has given, and the number of lost samples."""
    items, pipeline = subject.decode(log)
    given = pipeline.feed(RX, b"", log[-1][2])
    again = pipeline.feed(RX, b"", log[-1][2])
    need(not any(isinstance(item, Batch) for item in again), "samples are given again at a second end")
    count = sum(len(subject.rows(given, topic)) for topic in subject.constant)
    return [*items, *given], count, lost(subject.tape.losses, pipeline.losses).get("samples", 0)


def _missing(clock: SampleClock, whole: Items, items: Items, *, to_the_last: bool) -> int:
    """Return how many samples of a log are missing; `to_the_last`: of those up to the last one that is there."""
    expected, found = (_numbers(clock, some) for some in (whole, items))
    if to_the_last:
        expected = expected[: int(np.argmin(np.abs(expected - found[-1]))) + 1] if len(found) else found
    return len(expected) - len(found)


def _numbers(clock: SampleClock, items: Items) -> NDArray[np.float64]:
    found = together(items, clock.topic)
    return np.zeros(0) if found is None else np.asarray(found.columns[clock.field], np.float64)


def check_restart(subject: Subject) -> str:
    """Another device of the kind on the same line: its samples come, later, and the change is reported."""
    tape, other = subject.tape, subject.another
    later_ns = tape.reads[-1][2] + 1_000_000_000 - other.reads[0][2]
    items, _ = subject.decode([*tape.reads, *((d, data, ns + later_ns) for d, data, ns in other.reads)])
    for topic in subject.constant:
        whole, first, second = (together(x, topic) for x in (items, tape.items, other.items))
        assert whole is not None
        assert first is not None
        assert second is not None
        came, expected = len(whole.time_ns) - len(first.time_ns), len(second.time_ns)
        need(came >= 0.8 * expected, f"{topic}: {max(0, came)} of {number_of(expected, 'sample')} came after a restart")
        steps = np.diff(whole.time_ns)
        need(bool(np.all(steps >= 0)), f"{topic}: times step back over a restart, by {-int(steps.min()) * 1e-9:.3g} s")
        off = abs(int(whole.time_ns[-1]) - (other.reads[-1][2] + later_ns)) * 1e-9
        need(off < 1.0, f"{topic}: times are {off:.3g} s away from the host's after a restart")
    found = events(items, "restart", "gap")
    need(bool(found) or not subject.clocks, "a restart after a second of silence: neither restart nor gap is reported")
    return found[0].kind if found else "no clock to detect it by"


def check_counter_wrap(subject: Subject) -> str:
    """Samples continue when their number wraps."""
    if not subject.clocks:
        raise NotTried("its samples have no number")
    needed_s = max(clock.count_wrap / clock.rate_Hz for clock in subject.clocks)
    if needed_s > _LONGEST_WRAP_S:
        raise NotTried(f"its number wraps after {needed_s:.3g} s, longer than the simulation")
    tape = subject.record(needed_s + 2.0)
    _unbroken(subject, tape.items, tape.losses, f"over {needed_s + 2.0:.0f} s, with a wrap in them")
    return f"after {needed_s:.3g} s"


def check_clock_wrap(subject: Subject) -> str:
    """Samples continue when a clock in the device wraps, at the usual values."""
    if not subject.clocks:
        raise NotTried("its samples have no clock")
    for name, wrap_s in _CLOCK_WRAPS_S.items():
        tape = subject.record(2.0, clock_at_s=wrap_s - 1.0)
        _unbroken(subject, tape.items, tape.losses, f"with the device's clock passing {name}")
    return ", ".join(_CLOCK_WRAPS_S)


def _unbroken(subject: Subject, items: Items, losses: dict[str, int], when: str) -> None:
    wrong = events(items, "gap", "damage", "restart", "fault")
    need(not wrong, f"{when}: {wrong[0].kind}: {wrong[0].text}" if wrong else "")
    need(not any(losses.values()), f"{when}: losses {losses}")
    for clock in subject.clocks:
        whole = together(items, clock.topic)
        if whole is None:
            raise Failed(f"{when}: no samples in {clock.topic}")
        device_ns = np.asarray(whole.columns[clock.field], np.float64) * clock.tick_ns
        for name, steps in (("time_ns", np.diff(whole.time_ns)), (clock.field, np.diff(device_ns))):
            worst = float(np.max(np.abs(steps * 1e-9 * clock.rate_Hz - 1.0)))
            need(worst < 1.0, f"{when}: {name} of {clock.topic} steps by up to {worst + 1:.3g} periods")


def check_memory(subject: Subject) -> str:
    """The memory of a pipeline is bounded for any input of any length."""
    data = b"".join(data for direction, data, _ in subject.tape.reads if direction == RX)
    rng = np.random.default_rng(17)
    floods: dict[str, Callable[[], Iterable[bytes]]] = {
        "random bytes": lambda: (rng.bytes(4096) for _ in range(_FLOOD_BYTES // 4096)),
        "zeros": lambda: (bytes(4096) for _ in range(_FLOOD_BYTES // 4096)),
        "letters without an end of line": lambda: (b"t" * 4096 for _ in range(_FLOOD_BYTES // 4096)),
        "its own bytes, in pieces of 999": lambda: _every_other(data, 999),
    }
    largest = 0
    for name, flood in floods.items():
        _, pipeline = subject.decode(subject.tape.reads[:20])
        host_ns = subject.tape.reads[-1][2]
        began = time.perf_counter()
        for number, part in enumerate(flood()):
            pipeline.feed(RX, part, host_ns + number * 10_000_000)
        seconds = time.perf_counter() - began
        size = size_of(pipeline)
        need(size < _MOST_BYTES, f"after 1 MB of {name} it uses {size / 1e3:.0f} kB, expected 500 kB at most")
        need(seconds < 30.0, f"1 MB of {name} took {seconds:.0f} s")
        largest = max(largest, size)
    return f"{largest / 1e3:.0f} kB at most"


def _every_other(data: bytes, size: int) -> Iterable[bytes]:
    for start in range(0, _FLOOD_BYTES, size):
        at = (2 * start) % max(1, len(data) - size)
        yield data[at : at + size]
