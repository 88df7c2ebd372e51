"""Upper ends of a log's noise, from mean squares over parts of the log that no model has shaped."""

from __future__ import annotations

import numpy as np

from clampid.stages.rows import Array

__all__ = ["upper_ends"]

CREDIBLE = 2.0  # standard errors


def upper_ends(squares: Array) -> Array:
    """Upper ends of the noise of each motor: the root of the mean square plus two of its standard errors.

    Parameters
    ----------
    squares
        ``(n, parts)``: mean squares, Nm²; not finite where unknown.

    Returns
    -------
    numpy.ndarray
        ``(n,)``, Nm; infinite where half of the parts or more are unknown.
    """
    out = np.full(len(squares), np.inf)
    for motor, every in enumerate(squares):
        known = every[np.isfinite(every)]
        if len(known) > squares.shape[1] // 2:
            out[motor] = np.sqrt(known.mean() + CREDIBLE * known.std(ddof=1) / np.sqrt(len(known)))
    return out
