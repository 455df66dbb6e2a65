"""What releases end in: all stable states and slipping motions, which releases each one draws, how probable it is."""
