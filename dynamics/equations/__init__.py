"""The equations of motion: the rig's parameters, one run's scene and rotor phase, forces, and what balances them."""
