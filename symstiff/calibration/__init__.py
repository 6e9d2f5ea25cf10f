"""From measured deflections to parameters: tables, virtual experiments, identification, choice of poses."""
