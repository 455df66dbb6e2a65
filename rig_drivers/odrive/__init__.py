"""ODrive motor controllers on a CAN bus."""
