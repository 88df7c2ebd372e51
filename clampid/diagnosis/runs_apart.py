"""Whether runs of a log that repeat one motion may count as independent, judged beside what stands out.

What is wrong with a motion, such as accelerations from few samples, comes back in every run that repeats it. So the
tests flip the same stretch of all such runs together (:mod:`clampid.stages.repeats`). In a log of one motion, driven
six times, this leaves few signs to flip, and what is missing has no small p-value.

If a candidate explains all that the runs have in common, no error of the motion is left. Then the noise of each run is
independent, and each stretch of each run is flipped by itself. This is the test for lack of fit of a regression with
repeated points: what the mean of the runs is beyond the model, compared with how much they differ from it.

Source: Draper & Smith, Applied regression analysis, 1998, sect. 2.1 (lack of fit and pure error).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy import sparse, stats

from clampid.evidence.columns import channel_starts
from clampid.evidence.score import Scored
from clampid.evidence.space import Space
from clampid.fitting.solve import Estimate
from clampid.stages.repeats import first_of_repeated, nearest
from clampid.stages.rows import Integers, Rows

__all__ = ["LACKS", "lack_of_fit", "with_runs_apart"]

LACKS = 0.05  # chance that runs which have nothing in common are taken to have
TOGETHER = 4  # candidates that may explain together what runs have in common


def with_runs_apart(estimate: Estimate, space: Space, scored: Sequence[Scored]) -> Space:
    """The space of a log, each run with units of its own, if runs have nothing in common beside what explains most.

    Parameters
    ----------
    space
        Of the estimate's residual, in which runs of one motion share units.
    scored
        Candidates on this residual. Those of the largest evidence are tried, one after the other added.
    """
    rows, shared = estimate.problem.rows, len(np.unique(space.unit[: space.rows]))
    if not rows.kind.moving or not _several_runs_share(rows.unit, rows.series.run):
        return space
    repeated = first_of_repeated(rows.series.run, rows.constants.time, rows.signals["q"])
    own = _apart(rows, repeated)[estimate.whitened.entry]
    if len(np.unique(own)) <= shared:  # they are apart already
        return space
    first, beside = _first_entries(estimate, repeated), space
    for s in [None, *sorted((s for s in scored if s.bic > 0.0), key=lambda s: -s.bic)[:TOGETHER]]:
        if s is not None:
            beside = beside.granting(s.candidate.columns.dense(space.rows))
        if lack_of_fit(beside, first) > LACKS:
            return replace(space, unit=np.r_[own, own.max() + 1 + np.arange(len(space.residual) - space.rows)])
    return space


def lack_of_fit(space: Space, first: Integers) -> float:
    """The chance of so large a mean of repeated entries, compared with their scatter, where the model lacks nothing.

    Parameters
    ----------
    first
        ``(M,)``: the entry that each one repeats; itself if it repeats none.
    """
    count = np.bincount(first, minlength=space.rows)
    several = count[first] > 1
    place, number = np.unique(first[several], return_inverse=True)[1], count[first[several]]
    own = np.c_[space.residual[: space.rows][several], space.basis[: space.rows][several]]
    sums = sparse.csr_array((1.0 / np.sqrt(number), (place, np.arange(len(place))))) @ own
    common, absorbed = sums[:, 0], float(np.sum(sums[:, 1:] ** 2))
    whole, all_absorbed = float(own[:, 0] @ own[:, 0]), float(np.sum(own[:, 1:] ** 2))
    mean_squares = float(common @ common)
    freedom = len(common) - absorbed, len(own) - len(common) - (all_absorbed - absorbed)
    if min(freedom) < 1.0:
        return 0.0
    ratio = (mean_squares / freedom[0]) / max((whole - mean_squares) / freedom[1], 1e-300)
    return float(stats.f.sf(ratio, *freedom))


def _several_runs_share(unit: Integers, run: Integers) -> bool:
    """Whether rows of several runs are in one unit."""
    return len(np.unique(np.c_[unit, run], axis=0)) > len(np.unique(unit))


def _apart(rows: Rows, repeated: Integers) -> Integers:
    """Units ``(N,)`` of rows, those that repeat others apart from these."""
    again = np.where(repeated == np.arange(len(rows)), -1, rows.series.run)
    return np.asarray(np.unique(np.c_[rows.unit, again], axis=0, return_inverse=True)[1].ravel())


def _first_entries(estimate: Estimate, repeated: Integers) -> Integers:
    """The entry ``(M,)`` that each whitened number repeats, of the first run of its motion; itself if none.

    ``repeated`` ``(N,)``: the same of rows.
    """
    white = estimate.whitened
    out = np.arange(len(white.entry))
    for start, stop in channel_starts(white):
        entry = white.entry[start:stop]
        found = nearest(entry, repeated[entry])
        near = 2 * np.abs(entry[found] - repeated[entry]) <= estimate.noise.together - 1
        out[start:stop] = np.where(near, start + found, out[start:stop])
    return np.asarray(out)
