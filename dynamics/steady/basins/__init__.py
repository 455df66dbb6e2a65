"""End states of releases: all stable states and slipping motions, and their basins of attraction."""
