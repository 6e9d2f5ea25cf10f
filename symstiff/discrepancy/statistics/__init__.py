"""Columns against rows: projection, evidence, null distributions, lack of fit, and what can be seen at all."""
