"""Damping of the pendulums: spin-down on the resting rotor, transient after a release at speed."""
