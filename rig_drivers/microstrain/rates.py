"""Numbers of the maker that the settings need: sample rates and the address of base stations."""

from __future__ import annotations

BASE_ADDRESS = 0x1234
"""Address of every base station."""

RATES_HZ: dict[int, int] = {
    **{113 - n: 2**n for n in range(14)},
    **{61 + n: 1000 * n for n in range(1, 11)},
    46: 300,
    47: 800,
    48: 1600,
    49: 3200,
    98: 887,
}
"""Sample rate by its code, Hz; without those above 10 kHz and below 1 Hz, which no rotor needs."""
