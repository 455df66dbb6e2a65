"""What a release ends in: all stable states and slipping motions, the releases that each one draws, how probable it is."""
