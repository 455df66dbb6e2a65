"""The RotorLink node on the rotor: pendulum encoders, index marks and locks behind a radio dongle."""
