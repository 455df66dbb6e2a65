"""Drivers of devices other than those of the rig itself, found by entry points as those of any other package."""
