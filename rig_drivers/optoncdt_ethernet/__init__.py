"""optoNCDT 2300 displacement sensors on Ethernet: packets of frames over TCP."""
