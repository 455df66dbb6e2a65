"""Acquisition: transports, protocols, clocks, recorder, logs, guided tests, and the virtual rig."""
