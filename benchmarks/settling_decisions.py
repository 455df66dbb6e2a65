"""Decisions of `daq.signals.approach` that a quantity has settled, against what motions still do afterwards.

    uv run python -m benchmarks.settling_decisions --draws 600 --seed 1

Motions are drawn that the bound was not made for: one to three decays at 0.09 to 1.5 /s of either sign, or a decaying
swing, each with a quadratic part. Window means of 1 s have errors of 2e-5 to 4e-4 rad. A decision is made once a
second; the first one that the remaining change is below 0.05° is compared with the change that still follows.
"""

from __future__ import annotations

import argparse
import math
from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from daq.signals.approach import bound

Motion = Callable[[NDArray[np.float64]], NDArray[np.float64]]

TOLERANCE_RAD = math.radians(0.05)
FAR_RAD = 20 * TOLERANCE_RAD
KINDS = ("one decay", "two decays", "three decays", "swing")
WIDTHS_RAD = (2e-5, 1e-4, 4e-4)
SECONDS = 100
MOST_WINDOWS, LEAST_WINDOWS = 30, 9
STEP_S = 0.02


@dataclass(frozen=True)
class Decision:
    """First decision that a motion has settled.

    Attributes:
        late_s: time since the remaining change fell below the tolerance; negative if the decision was too early.
        left: largest change that follows, in tolerances.
    """

    late_s: float
    left: float


def draw(rng: np.random.Generator, kind: str) -> Motion:
    """Return a motion of the kind."""
    rates = np.exp(rng.uniform(math.log(0.09), math.log(1.5), 3))
    sizes = rng.uniform(-0.7, 0.7, 3)
    sizes[{"one decay": 1, "two decays": 2}.get(kind, 3) :] = 0.0
    curvature, turn, phase = rng.uniform(-0.3, 0.3), rng.uniform(0.3, 2.5), rng.uniform(0, 2 * math.pi)

    def motion(time_s: NDArray[np.float64]) -> NDArray[np.float64]:
        decays = sizes * np.exp(-rates * time_s[..., None])
        if kind == "swing":
            decays[..., 0] *= np.cos(turn * time_s + phase)
            decays[..., 2] = 0.0
        value = decays.sum(axis=-1)
        return np.asarray(value + curvature * value**2, np.float64)

    return motion


def decide(motion: Motion, width: float, rng: np.random.Generator) -> Decision | None:
    """Return the first decision; None if the motion is not called settled within the time."""
    inside = np.linspace(0.01, 0.99, 50)
    means = motion(np.arange(SECONDS)[:, None] + inside).mean(axis=1) + width * rng.uniform(-0.8, 0.8, SECONDS)
    edges = np.stack([np.arange(SECONDS), np.arange(1, SECONDS + 1)], axis=1).astype(np.float64)
    to_come = np.abs(motion(np.arange(0, 2 * SECONDS, STEP_S)))
    to_come = np.maximum.accumulate(to_come[::-1])[::-1]
    true_s = STEP_S * int(np.argmax(to_come <= TOLERANCE_RAD))
    for end in range(LEAST_WINDOWS, SECONDS + 1):
        moving = float(np.ptp(means[end - 3 : end]))
        used = slice(max(0, end - (LEAST_WINDOWS if moving > FAR_RAD else MOST_WINDOWS)), end)
        if bound(edges[used], means[used], width, 2.0, FAR_RAD).remaining <= TOLERANCE_RAD:
            return Decision(end - true_s, float(to_come[round(end / STEP_S)]) / TOLERANCE_RAD)
    return None


def main() -> None:
    """Print, for every kind of motion, how often and by how much a decision came too early, and how late it came."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--draws", type=int, default=600)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    rng = np.random.default_rng(options.seed)
    found = defaultdict[str, list[Decision | None]](list)
    for index in range(options.draws):
        kind = KINDS[index % len(KINDS)]
        found[kind].append(decide(draw(rng, kind), WIDTHS_RAD[index // len(KINDS) % len(WIDTHS_RAD)], rng))
    found["all"] = [each for kind in KINDS for each in found[kind]]
    print("| motion | over 1.1 tolerances left, % | over 2, % | most left | late, s: median, 90 % | never settled |")
    print("|---|---|---|---|---|---|")
    for kind, decisions in found.items():
        made = [each for each in decisions if each is not None]
        left, late = np.array([each.left for each in made]), np.array([each.late_s for each in made])
        shares = [100 * float(np.mean(left > limit)) for limit in (1.1, 2.0)]
        print(
            f"| {kind} | {shares[0]:.1f} | {shares[1]:.1f} | {left.max():.1f} | {np.median(late):.1f}, "
            f"{np.quantile(late, 0.9):.1f} | {len(decisions) - len(made)} of {len(decisions)} |"
        )


if __name__ == "__main__":
    main()
