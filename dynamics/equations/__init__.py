"""Equations of motion: parameters of the rig, scene and rotor phase of a run, forces, balancing."""
