"""Online estimation of states and pendulum damping by a compiled unscented Kalman filter."""
