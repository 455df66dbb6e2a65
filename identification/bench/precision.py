"""The benchmark of the estimators: cases, their sizes, and results against targets."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from dynamics.bench.records import Target
from dynamics.equations.parameters import RotorParameters
from identification.bench import library_peers, ours, ring_down_peers, run_up_peers, spins, tracking_peer
from identification.bench.decays import clipped_at, one_mode, two_axes, with_outliers
from identification.bench.ramps import passage
from identification.bench.releases import release
from identification.bench.trials import Method, Precision, SyntheticRecord, TrialSet, measure

SEED = 20261121
_RELEASE_SEED = 5804616  # keeps the records of the releases independent of the name of their case
_ONE, _TWO = {"f": ("f1_Hz",), "ζ": ("zeta1",)}, {"f": ("f1_Hz", "f2_Hz"), "ζ": ("zeta1", "zeta2")}
_GROSS = {"f": 0.05, "ζ": 1.0}
_RUN_UP_GROSS = {"f": 0.5, "ζ": 100.0}  # the results of the naive methods are shown but not counted as failures
_DAMPING = {"c": ("c_Nms_per_rad",)}
_BOTH_DAMPINGS = {"c": ("c3_Nms_per_rad", "c4_Nms_per_rad")}


@dataclass(frozen=True)
class BenchmarkSize:
    """Extent of a benchmark.

    Attributes:
        zetas: damping ratios of the one-mode ring-downs.
        damaged_zetas: damping ratios of those with outliers and of those clipped at the sensor's range.
        pairs: frequencies of two axes, Hz.
        run_up_zetas: damping ratios of the run-ups.
        dampings: dampings of the spin-downs, N m s/rad.
        runs: number of records of a clean ring-down or a spin-down.
        damaged_runs, pair_runs, run_up_runs, release_runs: number of records of the more expensive cases.
        release_truths: number of different motions among the releases.
        most_s: time per case, s, above which a method is applied to fewer records; not for the balanced setting.
    """

    zetas: tuple[float, ...]
    damaged_zetas: tuple[float, ...]
    pairs: tuple[tuple[float, float], ...]
    run_up_zetas: tuple[float, ...]
    dampings: tuple[float, ...]
    runs: int
    damaged_runs: int
    pair_runs: int
    run_up_runs: int
    release_runs: int
    release_truths: int
    most_s: float


FULL = BenchmarkSize(
    (1e-4, 1e-3, 0.01, 0.05, 0.2),
    (1e-3, 0.01),
    ((3.0, 5.0), (3.0, 3.01)),
    (1e-3, 0.01, 0.05),
    (1e-4, 1e-3, 1e-2),
    runs=100,
    damaged_runs=60,
    pair_runs=40,
    run_up_runs=40,
    release_runs=20,
    release_truths=3,
    most_s=8.0,
)
QUICK = BenchmarkSize(
    (1e-3, 0.05),
    (0.01,),
    ((3.0, 5.0),),
    (0.01,),
    (1e-3, 1e-2),
    runs=15,
    damaged_runs=15,
    pair_runs=6,
    run_up_runs=6,
    release_runs=3,
    release_truths=1,
    most_s=1.5,
)
_LEAST_RUNS = {  # smallest number of records for a comparison with a target
    "ring-down": FULL.damaged_runs,
    "two axes": FULL.pair_runs,
    "run-up": FULL.run_up_runs,
    "spin-down": FULL.runs,
    "release": FULL.release_runs,
    "tracking": FULL.release_runs,
}


def stages(physics: RotorParameters, size: BenchmarkSize) -> dict[str, Callable[[], list[Precision]]]:
    """Return the parts of a run in order, under the names shown to the user."""
    return {
        "ring-down": partial(_all, _ring_downs(size), size.runs, size.most_s),
        "damaged ring-down": partial(_all, _damaged(size), size.damaged_runs, size.most_s),
        "two axes": partial(_all, _pairs(size), size.pair_runs, size.most_s),
        "run-up": partial(_all, _run_ups(size), size.run_up_runs, size.most_s),
        "spin-down": partial(_all, _spin_downs(size), size.runs, size.most_s),
        "release": partial(_all, [_release(physics, size)], size.release_runs, size.most_s),
        "tracking": partial(_all, [_tracking(physics, size)], size.release_runs, size.most_s),
    }


def _all(cases: Sequence[TrialSet], runs: int, most_s: float) -> list[Precision]:
    return [row for case in cases for row in measure(case, runs, SEED, most_s)]


def _ring_down_methods() -> list[Method]:
    peers = ring_down_peers
    found = [
        *ours.methods("fit_ring_down", ours.ring_down),
        Method("log decrement", "raw maxima", peers.log_decrement, peer=True),
        Method("log decrement", "filtered, to 20 %", peers.careful_log_decrement, peer=True),
        Method("half-power", "spectrum", peers.half_power, peer=True),
        Method("Hilbert", "band-pass, to 20 %", peers.hilbert_envelope, peer=True),
        Method("matrix pencil / ERA", "own, 50 Hz means", peers.matrix_pencil, peer=True),
        Method("scipy least_squares", "all samples", peers.nonlinear_least_squares, peer=True),
    ]
    missing = library_peers.missing()
    if "pyOMA2" not in missing:
        found.append(Method("pyOMA2 SSI", "cov, 50 Hz means", library_peers.subspace_identification, peer=True))
    if "PyDMD" not in missing:
        found.append(Method("PyDMD BOPDMD", "50 Hz means", library_peers.dynamic_mode_decomposition, peer=True))
    return found


def _ring_downs(size: BenchmarkSize) -> list[TrialSet]:
    return [
        TrialSet("ring-down", f"ζ {z:g}, 20 s", partial(one_mode, zeta=z), _ONE, _GROSS, _ring_down_methods())
        for z in size.zetas
    ]


def _damaged(size: BenchmarkSize) -> list[TrialSet]:
    cases: list[TrialSet] = []
    for zeta in size.damaged_zetas:
        name = f"ζ {zeta:g}, 5 % outliers within ± 5 mm"
        cases.append(TrialSet("ring-down", name, partial(_outlying, zeta=zeta), _ONE, _GROSS, _ring_down_methods()))
        name = f"ζ {zeta:g}, 8 mm on a ± 5 mm sensor"
        cases.append(TrialSet("ring-down", name, partial(_clipped, zeta=zeta), _ONE, _GROSS, _ring_down_methods()))
    return cases


def _outlying(rng: np.random.Generator, zeta: float) -> SyntheticRecord:
    return with_outliers(rng, one_mode(rng, zeta), 0.05, 5e-3)


def _clipped(rng: np.random.Generator, zeta: float) -> SyntheticRecord:
    return clipped_at(one_mode(rng, zeta, amplitude_m=8e-3), 5e-3)


def _pairs(size: BenchmarkSize) -> list[TrialSet]:
    return [
        TrialSet(
            "two axes",
            f"{pair[0]:g} and {pair[1]:g} Hz, ζ 0.01, turned by 5°, 20 s",
            partial(two_axes, frequencies_Hz=pair, zeta=0.01, axis_angle_deg=5.0, record_s=20.0),
            _TWO,
            _GROSS,
            _ring_down_methods(),
        )
        for pair in size.pairs
    ]


def _run_ups(size: BenchmarkSize) -> list[TrialSet]:
    methods = [
        *ours.methods("fit_run_up", ours.run_up),
        Method("half-power", "order amplitude", run_up_peers.half_power, peer=True),
        Method("Vold–Kalman", "steady-state fit", run_up_peers.vold_kalman, peer=True),
    ]
    return [
        TrialSet(
            "run-up",
            f"ζ {z:g}, 3 and 5 Hz, 0.5 to 7 Hz in 60 s",
            partial(passage, zeta=z, record_s=60.0, frequencies_Hz=(3.0, 5.0), axis_angle_deg=5.0),
            _TWO,
            _RUN_UP_GROSS,
            methods,
        )
        for z in size.run_up_zetas
    ]


def _spin_downs(size: BenchmarkSize) -> list[TrialSet]:
    methods = [
        *ours.methods("fit_spin_down", ours.spin_down),
        Method("line", "logarithm of speed", spins.log_speed_line, peer=True),
        Method("scipy curve_fit", "all samples", spins.curve_fitting, peer=True),
    ]
    return [
        TrialSet(
            "spin-down",
            f"c {c:g} N m s/rad",
            partial(spins.spin_down, damping_Nms_per_rad=c),
            _DAMPING,
            {"c": 0.5},
            methods,
        )
        for c in size.dampings
    ]


def _release(physics: RotorParameters, size: BenchmarkSize) -> TrialSet:
    draw = partial(release, physics=physics, wrong_start=10.0, record_s=5.0, truths=size.release_truths)
    name = "8 Hz, 5 s, start values of c3 and c4 ten times wrong"
    methods = ours.methods("fit_release", ours.release)
    return TrialSet("release", name, draw, _BOTH_DAMPINGS, {"c": 0.5}, methods, seed=_RELEASE_SEED)


def _tracking(physics: RotorParameters, size: BenchmarkSize) -> TrialSet:
    draw = partial(release, physics=physics, wrong_start=10.0, record_s=5.0, truths=size.release_truths)
    methods = [
        Method("Tracker", "online", ours.tracking, every_record=True),
        Method("filterpy UKF", "compiled motion", tracking_peer.unscented_filter, peer=True),
    ]
    name = "8 Hz, the same releases, c3 and c4 at the end"
    return TrialSet("tracking", name, draw, _BOTH_DAMPINGS, {"c": 0.5}, methods, "update", tracking_peer.updates)


@dataclass(frozen=True)
class _Requirement:
    """Target of the balanced setting in some cases of a service.

    Attributes:
        name: name of the target.
        service: service of the cases.
        of: whether a case belongs to the target.
        wanted: largest allowed value.
        figure: function from the rows of the cases to the value.
    """

    name: str
    service: str
    of: Callable[[str], bool]
    wanted: float
    figure: Callable[[Sequence[Precision]], float]


def targets(rows: Iterable[Precision]) -> list[Target]:
    """Return the results of the balanced setting against their targets, for cases with sufficient records."""
    own = [r for r in rows if r.setting in ("balanced", "online") and not r.peer and _has_sufficient_runs(r)]
    found: list[Target] = []
    for requirement in _REQUIREMENTS:
        chosen = [r for r in own if r.service == requirement.service and requirement.of(r.case)]
        if chosen:
            found.append(Target(requirement.name, requirement.wanted, requirement.figure(chosen)))
    return found


def _has_sufficient_runs(row: Precision) -> bool:
    return row.runs >= _LEAST_RUNS[row.service]


def _rms(rows: Sequence[Precision]) -> float:
    """Return the rms of all values of the rows together; inf if a row has no values."""
    squares = [v**2 for r in rows for v in (r.rms.values() or [np.inf])]
    return float(np.sqrt(np.mean(squares)))


def _uncovered(rows: Sequence[Precision]) -> float:
    """Return the distance of the pooled coverage from 95 %, in per cent."""
    shares = [c for r in rows for c in r.coverage.values() if c is not None]
    return abs(100 * float(np.mean(shares)) - 95.0) if shares else np.inf


def _gross(rows: Sequence[Precision]) -> float:
    return float(sum(r.gross for r in rows))


def _slowest(rows: Sequence[Precision]) -> float:
    return max(r.seconds for r in rows)


def _clean(case: str) -> bool:
    return "outliers" not in case and "sensor" not in case


def _every(case: str) -> bool:
    return True


_REQUIREMENTS = (
    _Requirement("ring-down, rms over bound, all ζ", "ring-down", _clean, 1.054, _rms),
    _Requirement("ring-down, coverage off 95 %, %", "ring-down", _clean, 2.0, _uncovered),
    _Requirement("ring-down, gross failures, damaged ones too", "ring-down", _every, 0.0, _gross),
    _Requirement("ring-down with outliers, rms over bound", "ring-down", lambda c: "outliers" in c, 1.25, _rms),
    _Requirement("ring-down at the rail, rms over clean bound", "ring-down", lambda c: "sensor" in c, 3.0, _rms),
    _Requirement("two axes, rms over bound", "two axes", _every, 1.15, _rms),
    _Requirement("run-up, gross failures", "run-up", _every, 0.0, _gross),
    _Requirement("run-up, coverage off 95 %, %", "run-up", _every, 2.0, _uncovered),
    _Requirement("run-up of 60 s, s", "run-up", _every, 0.2, _slowest),
    _Requirement("spin-down, rms over bound", "spin-down", _every, 1.2, _rms),
    _Requirement("spin-down, coverage off 95 %, %", "spin-down", _every, 2.0, _uncovered),
    _Requirement("release, gross failures", "release", _every, 0.0, _gross),
    _Requirement("tracking, µs an update", "tracking", _every, 20.0, lambda rows: 1e6 * _slowest(rows)),
    _Requirement("release, s", "release", _every, 1.0, _slowest),
)
