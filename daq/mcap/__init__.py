"""MCAP at the speed of the disk: written in blocks, read from the summary or by a walk, every checksum checked.

`writer` writes; `reader` finds out what is in a file, `summary_reader` from its end, `walk` from its start.
"""
