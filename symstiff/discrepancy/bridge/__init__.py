"""Between a model and the statistics: candidates from the catalogue, and effects that join the model."""
