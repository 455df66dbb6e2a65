"""Work that is done in many parts: maps, campaigns by the hundred, an archive of logs; on one machine or on many.

A `Study` says what is asked and in how many tiles. A `TileFolder` keeps one finished file per tile. An engine works
tiles out, in this process, in processes of its own or on dask's workers. `run_study` joins the three: what the folder
has is not worked out again, so the same command goes on where a killed one stopped.
"""
