"""Search for devices: ports of this machine, the drivers whose devices are on them, and tables for the rig file."""
