"""The motion over time: steps, their control, events and dry friction's modes, and the motion's derivatives."""
