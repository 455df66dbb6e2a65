"""Channels of an imported log: without device counters; the time is that of the message."""

from daq.channels import Channel

DISPLACEMENT_X = Channel("laser/x", "rig.Displacement", (("displacement_m", "double"),))
DISPLACEMENT_Y = Channel("laser/y", "rig.Displacement", (("displacement_m", "double"),))
PENDULUM_ANGLES = Channel("pendulums", "rig.PendulumAngles", (("theta3_rad", "double"), ("theta4_rad", "double")))
ROTOR_PHASE = Channel("tacho", "rig.RotorPhase", (("phase_rad", "double"),))
ROTOR_MARK = Channel("tacho", "rig.RotorMark", (("revolutions", "fixed32"),))
