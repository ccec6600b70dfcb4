"""The processes of `record`: capture, tracker, estimator. Capture never runs a solver."""
