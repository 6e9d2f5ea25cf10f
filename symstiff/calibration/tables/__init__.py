"""Measurement tables, poses tables and trajectories: CSV in and out, every mistake with its line."""
