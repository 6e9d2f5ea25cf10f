"""What is wrong with a table as a whole: axes, signs, units, a marker elsewhere, loads that tell nothing."""
