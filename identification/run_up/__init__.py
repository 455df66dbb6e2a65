"""Passage through both resonances: frequencies, damping ratios and the imbalance, whatever the ramp."""
