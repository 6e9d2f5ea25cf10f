"""Least squares as calibration needs it: what rows share, ranks, deviations, outliers, physics as a constraint."""
