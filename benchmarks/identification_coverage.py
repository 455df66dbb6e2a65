"""How good the identification is: coverage, bias and spread over made-up campaigns.

    python benchmarks/identification_coverage.py [campaigns] [--points]

Each campaign draws its own gains, zeros, clocks, noise and losses. Printed per rig variant and parameter: the mean and
spread of z = (found − true)/std (0 and 1 when intervals are honest), the share within one and two, the largest, and
the relative std; then the same for each test alone, and the time per campaign.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "identification"))

from synthetic import Campaign

from identification import IdentificationError, identify

TRUTH = "virtual.truth"
VARIANTS: dict[str, dict[str, object]] = {
    "as shipped": {},
    "k2 +7 %": {f"{TRUTH}.suspension.k2_N_per_m": "+7%"},
    "ζ1 × 2": {f"{TRUTH}.suspension.zeta1": "*2"},
    "c3 × 1.5, c4 × 0.7": {
        f"{TRUTH}.pendulums.a.damping_Nms_per_rad": "*1.5",
        f"{TRUTH}.pendulums.b.damping_Nms_per_rad": "*0.7",
    },
    "M_B = 0.070 kg": {"pendulums.b.mass_kg": 0.070},
}


def main() -> None:
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 20
    points = "--points" in sys.argv
    pooled: list[float] = []
    for label, settings in VARIANTS.items():
        z: dict[str, list[float]] = {}
        relative: dict[str, list[float]] = {}
        seconds = []
        for seed in range(count):
            campaign = Campaign(seed, settings)
            runs = campaign.commissioning()
            if points:
                runs += [campaign.point("D"), campaign.point("E")]
            began = time.perf_counter()
            try:
                found = identify(runs, campaign.rig)
            except IdentificationError as error:
                print(f"{label}, seed {seed}: {error}")
                continue
            seconds.append(time.perf_counter() - began)
            for warning in found.warnings:
                print(f"  {label}, seed {seed}: {warning}")
            true = campaign.truth.identified()
            for name, value in found.parameters.values.items():
                z.setdefault(name, []).append((value - true[name]) / found.parameters.std[name])
                relative.setdefault(name, []).append(found.parameters.std[name] / value)
            for estimate in found.estimates:
                for name in estimate.names:
                    own = (estimate.value(name) - true[name]) / estimate.std[name]
                    z.setdefault(f"  {estimate.test} {name}", []).append(own)
                    relative.setdefault(f"  {estimate.test} {name}", []).append(estimate.std[name] / true[name])
        print(f"\n{label}: {count} campaigns, {np.median(seconds):.2f} s each (largest {max(seconds):.2f} s)")
        print(f"{'':32}{'mean z':>8}{'sd z':>8}{'|z|<1':>8}{'|z|<2':>8}{'max':>8}{'std/value':>12}")
        for name, values in z.items():
            a = np.abs(values)
            print(
                f"{name:32}{np.mean(values):8.2f}{np.std(values):8.2f}{np.mean(a < 1):8.2f}{np.mean(a < 2):8.2f}"
                f"{a.max():8.2f}{np.median(relative[name]):12.2e}"
            )
        pooled += [v for name, values in z.items() if not name.startswith(" ") for v in values]
    a = np.abs(pooled)
    print(
        f"\npooled over {len(a)} values: |z| < 1 {np.mean(a < 1):.3f}, < 2 {np.mean(a < 2):.3f}, largest {a.max():.2f}"
    )


if __name__ == "__main__":
    main()
