"""Motion over time: integration steps, step control, events, modes of dry friction, and derivatives of the motion."""
