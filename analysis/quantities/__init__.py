"""Quantities of a rotating machine: order vectors, orbits, spectra, slip; from roles, not devices."""
