"""The virtual rig: a process whose ports behave like those of a real rig.

It integrates the nonlinear motion with its true parameters, simulates imperfect sensors, and implements the protocols
of the devices on ptys or TCP ports. Actions of a person at the rig (pluck, flick, move a clamp) are requests to its
control port, which only the simulated operator uses. Only simulations and far ends import this package.
"""
