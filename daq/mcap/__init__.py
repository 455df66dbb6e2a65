"""MCAP files: written in blocks, read from the summary or by a walk over the whole file; every checksum is verified.

`writer` writes. `reader` determines the contents of a file; `summary_reader` starts at its end, `walk` at its start.
"""
