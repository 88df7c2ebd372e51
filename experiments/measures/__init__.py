"""Metrics of measurements: error norms, ISO 9283, returns to a pose, and points from distances."""
