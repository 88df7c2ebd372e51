"""Verdicts from few rows: whether held-out errors can be judged, and how much errors of the estimates add to them.

The held-out error of a fit of p parameters is larger than its residual. If the model is right and n numbers are fitted,
the mean square of held-out errors is 1 + p / (n - p - 1) times that of the noise.

Source: Breiman and Freedman, How many variables should be entered in a regression equation?, J. Am. Stat. Assoc. 78,
1983: the mean squared error of prediction, of normal regressors.
"""

from __future__ import annotations

import numpy as np

from clampid.fitting.solve import Estimate, FitError
from clampid.identification.fitted_stage import FittedStage, freedom_of

__all__ = ["estimates_share", "expected_over_noise", "refuse_unjudged"]

FITTED = 0.8  # of the rows: what is left where each fifth is predicted from the others
NOTABLE = 1.3  # from this factor on the error of the estimates is a part of what is judged


def expected_over_noise(estimate: Estimate, verified: bool) -> float:
    """Expected error of held-out rows under a right model, over the noise; infinite without degrees of freedom.

    Parameters
    ----------
    verified
        Whether a verification table is used, so that all rows are fitted.
    """
    numbers, determined = freedom_of(estimate)
    left = (1.0 if verified else FITTED) * numbers - determined - 1.0
    return float(np.sqrt(1.0 + determined / left)) if left > 0.0 else float("inf")


def estimates_share(estimate: Estimate, verified: bool) -> float:
    """Held-out error over the noise floor that errors of the estimates alone explain; 1 if it is hardly more.

    Parameters
    ----------
    verified
        Whether a verification table is used, so that all poses are fitted.
    """
    if verified or not estimate.problem.kind.points:
        return 1.0
    found = expected_over_noise(estimate, verified)
    return found if found >= NOTABLE else 1.0


def refuse_unjudged(fitted: FittedStage, verified: bool) -> None:
    """Refuse poses without degrees of freedom in four fifths of them: no held-out error would reveal an effect.

    Raises
    ------
    FitError
        Too few numbers were measured.
    """
    estimate = fitted.estimate
    if verified or not estimate.problem.kind.points or np.isfinite(expected_over_noise(estimate, verified)):
        return
    numbers, determined = freedom_of(estimate)
    raise FitError(
        "poses: expected measured numbers of which four fifths are more than the parameters that they determine, "
        f"found {numbers} and {determined}: too few degrees of freedom are left to separate a missing effect from the "
        "error of the fit; measure more poses, or a table verification"
    )
