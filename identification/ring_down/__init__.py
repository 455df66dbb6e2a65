"""Free decay of the locked rotor: natural frequencies, damping ratios and the sensors' axis angle."""
