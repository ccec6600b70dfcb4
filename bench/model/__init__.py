"""What the learned model has to beat, measured: `python -m bench.model`."""
