"""Stability of a motion: Floquet multipliers, the once-a-revolution map, stability maps and borders of Type I."""
