"""The rig while it runs: states and pendulum damping by a compiled unscented Kalman filter."""
