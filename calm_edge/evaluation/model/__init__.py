"""What the learned model has to beat, measured: `python -m calm_edge.evaluation.model`."""
