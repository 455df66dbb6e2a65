"""An open rig: readers, recorder, and what watches its channels while they run."""
