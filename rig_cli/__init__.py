"""The `rig` command."""
