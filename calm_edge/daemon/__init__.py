"""The processes of `record`: capture, tracker, estimator, and the outputs."""
