"""Emitters: each walks a Program; templates do text, Python does logic."""
