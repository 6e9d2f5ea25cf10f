"""The noise: its scale, what the rows of a pose share, and what the rows of a reading share."""
