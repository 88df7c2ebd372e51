"""Choosing measurements: what each candidate would tell about the asked parameters, and which to take."""

from clampid.planning.choose import choose, exchange, greedy, log_det
from clampid.planning.expected import predicted_covariance
from clampid.planning.indices import observability

__all__ = ["choose", "exchange", "greedy", "log_det", "observability", "predicted_covariance"]
