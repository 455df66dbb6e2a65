"""Estimation of natural frequencies, damping ratios and the axis angle of the sensors from free decays."""
