"""What can be told apart, and the poses and loads that would tell rivals apart."""
