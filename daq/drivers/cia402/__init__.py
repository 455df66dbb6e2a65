"""Motor drives with the CiA 402 profile on a CAN bus."""
