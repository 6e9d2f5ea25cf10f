"""Compensation of compliance errors: off-line for trajectories, and the reference for what the C code does on-line."""

from symstiff.compensation.trajectory import Compensated, compensate, compensate_online

__all__ = ["Compensated", "compensate", "compensate_online"]
