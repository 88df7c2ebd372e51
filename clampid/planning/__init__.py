"""Optimal choice of measurements: plans whose measurements carry the most information on the wanted parameters."""

from clampid.fitting.observability import observability
from clampid.planning.choose import choose, exchange, greedy, log_det
from clampid.planning.expected import predicted_covariance

__all__ = ["choose", "exchange", "greedy", "log_det", "observability", "predicted_covariance"]
