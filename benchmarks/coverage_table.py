"""The table of a coverage study: how often 95 % intervals hold the truth, parameter by parameter."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

__all__ = ["TWO_SIDED_95", "Coverage", "coverage"]

TWO_SIDED_95 = 1.959963984540054


@dataclass(frozen=True)
class Coverage:
    """What the errors of many trials, in standard errors, say of the intervals.

    Attributes
    ----------
    share, rms, mean
        By parameter: share of trials whose 95 % interval holds the truth; rms and mean of error over standard error.
    pooled
        The share of all of them together.
    count
        By parameter: how many trials stated it.
    """

    share: Mapping[str, float]
    rms: Mapping[str, float]
    mean: Mapping[str, float]
    pooled: float
    count: Mapping[str, int]

    def table(self) -> str:
        """One line a parameter."""
        width = max((len(name) for name in self.share), default=0)
        lines = [f"{'':>{width}}  covered   rms   mean   of error over standard error"]
        for name, share in self.share.items():
            lines.append(f"{name:>{width}} {100 * share:6.1f} %  {self.rms[name]:5.2f}  {self.mean[name]:+5.2f}")
        return "\n".join(lines)

    @property
    def summary(self) -> str:
        """All together, and the worst and the best parameter."""
        worst, best = min(self.share, key=self.share.__getitem__), max(self.share, key=self.share.__getitem__)
        return (
            f"{100 * self.pooled:.1f} % of all, {100 * self.share[worst]:.1f} % ({worst}) to "
            f"{100 * self.share[best]:.1f} % ({best})"
        )


def coverage(trials: Sequence[Mapping[str, float]], stated_by: float = 1.0) -> Coverage:
    """Coverage from each trial's errors over standard errors, of the parameters that so many trials state.

    Parameters
    ----------
    trials
        Per trial: parameter to (estimate less truth) over standard error.
    stated_by
        The least share of the trials.
    """
    names = list(dict.fromkeys(name for trial in trials for name in trial))
    z = {name: np.array([trial[name] for trial in trials if name in trial]) for name in names}
    z = {name: values for name, values in z.items() if len(values) >= stated_by * len(trials)}
    return Coverage(
        share={name: float(np.mean(np.abs(v) < TWO_SIDED_95)) for name, v in z.items()},
        rms={name: float(np.sqrt(np.mean(v**2))) for name, v in z.items()},
        mean={name: float(np.mean(v)) for name, v in z.items()},
        pooled=float(np.mean(np.abs(np.concatenate([*z.values()])) < TWO_SIDED_95)) if z else float("nan"),
        count={name: len(v) for name, v in z.items()},
    )
