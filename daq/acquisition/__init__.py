"""Acquisition from an open rig: sessions, readers, the recorder, interlocks and channel watches."""
