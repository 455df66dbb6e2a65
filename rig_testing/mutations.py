"""Recorded bytes with random damage: the pipeline does not fail, and a checksum rejects wrong samples."""

from __future__ import annotations

import time

import numpy as np

from daq.items import RX
from rig_basics.texts import number_of
from rig_testing.bench import Items
from rig_testing.processes import each_answer
from rig_testing.report import Failed, need
from rig_testing.sizes import size_of
from rig_testing.subject import Subject

QUICK, THOROUGH = 10_000, 1_000_000
_SEED = 19
_READS = 3  # reads of an excerpt
_PER_EXCERPT = 50  # damaged inputs of an excerpt
_SLOW_S = 5.0  # longest processor time for one damaged excerpt
_MOST_BYTES = 1 << 20
_UNDETECTED_SHARE = 3 / 2**16  # of inputs that a check of 16 bits lets pass, with a margin
_UNDETECTED_BY_CHANCE = 2


def check_mutations(subject: Subject) -> str:
    """10⁴ damaged inputs (10⁶ when thorough): no crash, no hang, bounded memory; with a checksum, no wrong samples
    except in inputs that the checksum lets pass.
    """
    count = THOROUGH if subject.thorough else QUICK
    excerpts = range(-(-count // _PER_EXCERPT))
    wrong = samples = inputs = 0
    for done, found in enumerate(each_answer(damaged_excerpt, subject, excerpts), 1):
        wrong, samples, inputs = wrong + found[0], samples + found[1], inputs + found[2]
        subject.progress(done / len(excerpts))
    damaged = len(excerpts) * _PER_EXCERPT
    words = (
        f"{number_of(damaged, 'input')}: {wrong} of "
        f"{number_of(samples, 'sample differs', 'samples differ')} from those sent, in {number_of(inputs, 'input')}"
    )
    if subject.claims("checksum"):
        need(inputs <= _UNDETECTED_BY_CHANCE + _UNDETECTED_SHARE * count, f"{words}, but the driver claims a checksum")
    return words


def damaged_excerpt(subject: Subject, number: int) -> tuple[int, int, int]:
    """Decode damaged copies of an excerpt, which depend on its number alone.

    Returns:
        Number of wrong samples, of all samples, and of inputs with wrong ones.
    """
    rng = np.random.default_rng([_SEED, number])
    first = int(rng.integers(0, max(1, len(subject.tape.reads) - _READS)))
    return _some_wrong(subject, first, rng)


def _some_wrong(subject: Subject, first: int, rng: np.random.Generator) -> tuple[int, int, int]:
    excerpt = subject.tape.reads[first : first + _READS]
    clean, _ = subject.decode(excerpt)
    sent = {topic: _rows(subject, clean, topic) for topic in subject.channels}
    wrong = samples = inputs = 0
    for number in range(_PER_EXCERPT):
        damaged = [(d, mutated(data, rng) if d == RX else data, ns) for d, data, ns in excerpt]
        began = time.thread_time()
        try:
            items, pipeline = subject.decode(damaged)
        except Exception as error:
            what = [data.hex() for d, data, _ in damaged if d == RX]
            raise Failed(f"{type(error).__name__}: {error}; by {what!s:.600}") from error
        seconds = time.thread_time() - began
        need(
            seconds < _SLOW_S, f"an input of {number_of(sum(len(r[1]) for r in damaged), 'byte')} took {seconds:.0f} s"
        )
        if number == 0:
            size = size_of(pipeline)
            need(size < _MOST_BYTES, f"it uses {size / 1e3:.0f} kB after three damaged reads")
        before = wrong
        for topic, rows in sent.items():
            found = _rows(subject, items, topic)
            samples += len(found)
            wrong += len(found - rows)
        inputs += wrong > before
    return wrong, samples, inputs


def _rows(subject: Subject, items: Items, topic: str) -> set[bytes]:
    """Return the measured values, sample for sample, without samples marked as not readings."""
    rows = subject.rows(items, topic)
    rows = np.ascontiguousarray(rows[np.all(np.isfinite(rows), axis=1)])
    return set(rows.view(f"V{8 * rows.shape[1]}").ravel().tolist()) if rows.size else set()


def mutated(data: bytes, rng: np.random.Generator) -> bytes:
    """Return a copy of bytes with up to three damages."""
    out = bytearray(data)
    for _ in range(int(rng.integers(0, 4))):
        if not out:
            break
        at, size = int(rng.integers(0, len(out))), int(rng.integers(1, 9))
        match int(rng.integers(0, 7)):
            case 0:
                out[at] ^= 1 << int(rng.integers(0, 8))
            case 1:
                out[at] = int(rng.integers(0, 256))
            case 2:
                del out[at : at + size]
            case 3:
                out[at:at] = rng.bytes(size)
            case 4:
                out[at:at] = out[at : at + size]
            case 5:
                out[at : at + size] = out[at : at + size][::-1]
            case _:
                del out[at:]
    return bytes(out)
