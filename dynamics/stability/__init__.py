"""Small deviations from a motion: Floquet multipliers, the once-a-revolution map, the map of the balanced state."""
