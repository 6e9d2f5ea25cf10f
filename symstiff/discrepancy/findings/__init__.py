"""What a diagnosis hands back, and what it says of a table."""
