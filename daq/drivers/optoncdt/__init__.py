"""Micro-Epsilon optoNCDT displacement sensors on a serial line."""
