"""The same release with heyoka in a new process: `python -m dynamics.bench.first_release_heyoka`."""

from __future__ import annotations

from dynamics.arrays import Array
from dynamics.bench import heyoka_peer
from dynamics.bench.release_start import ACCURACY, DURATION_S, release_start


def first_release() -> Array:
    """θ3 and θ4 at the end of the release, shape (2,)."""
    integrator = heyoka_peer.integrator(*release_start(), ACCURACY)
    integrator.propagate_until(DURATION_S)
    return integrator.state[2:4]


if __name__ == "__main__":
    print(*first_release())
