"""Processor time and result of ring-downs of other worlds than the model's.

    python -m benchmarks.unforeseen_decays [--seed 1] [--only WORLD …]

The worlds are those of the tests (tests/identification/decay_worlds.py). Printed per world: seconds of processor of
`fit_ring_down`, and its values or its refusal. The first world is fitted twice, so that the compiled code is loaded.
"""

from __future__ import annotations

import argparse
import time

from identification import IdentificationError, fit_ring_down
from tests.identification.decay_worlds import WORLDS


def result_of(name: str, seed: int) -> str:
    """Values with their standard deviations, or the refusal."""
    try:
        fit = fit_ring_down(*WORLDS[name](seed))
    except IdentificationError as error:
        return f"{type(error).__name__}: {error}"
    return ", ".join(f"{key} {value:.6g} ± {fit.std[key]:.1g}" for key, value in fit.values.items())


def main() -> None:
    """Fit the chosen worlds and print one line for each."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", nargs="*", choices=sorted(WORLDS), default=list(WORLDS))
    options = parser.parse_args()
    result_of(options.only[0], options.seed)
    for name in options.only:
        begun = time.process_time()
        text = result_of(name, options.seed)
        print(f"{name:20} {time.process_time() - begun:6.2f} s  {text[:160]}", flush=True)


if __name__ == "__main__":
    main()
