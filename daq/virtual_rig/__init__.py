"""A process that behaves on its wires like the rig."""
