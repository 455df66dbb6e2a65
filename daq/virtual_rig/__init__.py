"""A process that behaves on its wires like the rig.

It integrates the nonlinear motion of its own truth, lets imperfect sensors look at it, and speaks the devices' own
protocols on ptys or TCP ports. What a person does by hand on a rig (pluck, flick, move a clamp) reaches it through a
control port that only the simulated operator uses. Nothing else in the suite imports this package.
"""
