"""Estimation of frequencies, damping ratios and imbalance from a passage through both resonances, for any ramp."""
