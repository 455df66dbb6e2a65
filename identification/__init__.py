"""Finds k1, k2, ζ1, ζ2, c3, c4 and S_P from recorded runs, with covariance."""
