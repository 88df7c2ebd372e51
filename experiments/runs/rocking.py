"""Finds a clamp that rocks, from the motors at rest while another one is driven.

A block that stands unevenly tilts from one rest to another when the load on it changes its sign, and back when the load
turns. Each standing motor's torque then has, beside what it may follow in any case (`experiments.runs.slips`),

    tau = ... + s r,   min(max(r, f(u - u+)), f(u - u-)) -> r,   f(x) = x/w, bounded to ±1/2

with the same s at every turn: the block tilts at a wind-up of u+ on the way forward and at u- <= u+ on the way back,
within w of the driven joint's way. Each (u-, u+, w) of a grid is tried, in the last sweep and in the means of the last
2, 4, ... of the same joint: the block tilts alike in them, and noise does not. The mean over the standing motors of
s² over its variance follows Fisher's distribution; the noise is that of `experiments.runs.sweep_noise`. A tilt also has
to give way: the flange moves as the load pushes. A clearance that a standing drive crosses looks alike, and pushes
back. And it has to explain more than u^3: a block that yields gets stiffer smoothly.

The probability is multiplied by the number of grid points, of means and of tests in a run (Bonferroni).
`experiments.runs.loosening` is more sensitive to a clamp that begins to rock.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy import stats

from experiments.plans.motion import Array
from experiments.runs.slips import SweepRows, design_of
from experiments.runs.sweep_noise import Noise, alike, noise_of, waves
from experiments.runs.yielding import flange_shift, push_of
from kinematics.description import RobotDescription

__all__ = ["Rocking", "find_rocking"]

LEAST_TURNS = 3  # of the block in a sweep; one or two are a shift, or one and its way back
EDGE = 3  # readings in either rest
WIDTHS = (0.01, 0.25, 0.5, 1.0)  # of the largest wind-up: over how much of the way the block tilts
POWERS = (1,)  # of the wind-up, regressors without a tilt
HARMONICS = 6  # of the loop, in which noise is distinguished
LEAST_LEFT = 0.02  # of a template's squares; the rest is explained without a tilt

Indices = npt.NDArray[np.int64]


@dataclass(frozen=True)
class Rocking:
    """A clamp that rocks.

    Attributes
    ----------
    first, last
        Numbers of the sweeps that show it together.
    turns
        How often the block tilted in each.
    size
        About how far, m, from rest to rest, with springs as described.
    forward, backward
        At which wind-up of the driven joint it tilts on the way forward and back, rad.
    p_value
        Over all that was tried in the run.
    """

    first: int
    last: int
    turns: int
    size: float
    forward: float
    backward: float
    p_value: float


def find_rocking(
    sweeps: Sequence[SweepRows],
    robot: RobotDescription,
    stiffness: Array,
    jacobian: Array,
    joint: int,
    *,
    looks: int = 1,
    level: float,
) -> Rocking | None:
    """Whether the clamp rocks, as the last sweep shows, or the last ones of its joint together.

    Parameters
    ----------
    sweeps
        All of this clamping, in order.
    stiffness
        Of the drives as described, Nm/rad at the motors, ``(n,)``.
    jacobian
        ``(6, n)`` of the flange in the clamped posture.
    joint
        The driven one, from 0.
    looks
        How often the run makes this test.
    level
        Probability of a false alarm in all of these tests.
    """
    now = sweeps[-1]
    same = [sweep for sweep in sweeps if alike(sweep, now)]
    still = np.flatnonzero(~now.turned).astype(np.int64)
    noise = noise_of([s for s in sweeps if len(s.time) == len(now.time)], HARMONICS)
    if not len(still) or noise is None:
        return None
    pairs, states = _states(now.offset)
    windows = [2**k for k in range(len(same).bit_length())]
    tests = len(pairs) * len(windows) * looks
    found: Rocking | None = None
    for window in windows if len(pairs) else ():
        rows = same[-window:]
        size, error, freedom = _sizes(rows, still, states, noise)
        ratio = _ratio(size, error)
        p_values = stats.f.sf(ratio, len(still), freedom) * tests
        best = int(np.argmin(p_values))
        p = float(p_values[best])
        if p > level or (found is not None and p >= found.p_value):
            continue
        bent = (now.offset / np.max(np.abs(now.offset)))[:, None] ** 3
        if _ratio(*_sizes(rows, still, bent, noise)[:2])[0] >= ratio[best]:
            continue
        shift = flange_shift(size[:, best], error[:, best], still, robot, stiffness, jacobian)
        if shift @ push_of(robot, stiffness, jacobian, joint) <= 0.0:
            continue
        turns = int(_turns(states[:, [best]])[0])
        forward, backward = (float(value) for value in pairs[best])
        found = Rocking(rows[0].number, now.number, turns, float(np.linalg.norm(shift)), forward, backward, p)
    return found


def _states(offset: Array) -> tuple[Array, Array]:
    """Where a block may tilt forward and back ``(R, 2)``, rad, and how it lies at each reading then ``(m, R)``."""
    levels = np.unique(np.r_[0.0, offset])
    between = (levels[1:] + levels[:-1]) / 2
    most = float(np.max(np.abs(offset)))
    grid = [(f, b, w) for k, b in enumerate(between) for f in between[k:] for w in WIDTHS]
    forward, backward, width = np.array(grid).T * np.array([[1.0], [1.0], [most]])
    states = np.empty((len(offset), len(grid)))
    state = sum(np.clip(-centre / width, -0.5, 0.5) for centre in (forward, backward)) / 2
    for k, u in enumerate(offset):
        least, largest = (np.clip((u - centre) / width, -0.5, 0.5) for centre in (forward, backward))
        states[k] = state = np.minimum(np.maximum(state, least), largest)
    rests = np.minimum(np.sum(states > 0, axis=0), np.sum(states < 0, axis=0))
    kept = (rests >= EDGE) & (_turns(states) >= LEAST_TURNS)
    return np.column_stack([forward, backward])[kept], states[:, kept]


def _turns(states: Array) -> npt.NDArray[np.int64]:
    """How often each column changes its sign ``(R,)``."""
    return np.asarray(np.count_nonzero(np.diff(states > 0.0, axis=0), axis=0), dtype=np.int64)


def _sizes(rows: Sequence[SweepRows], still: Indices, states: Array, noise: Noise) -> tuple[Array, Array, Array]:
    """Step of each tilt by motor in the mean of sweeps, Nm, and its standard error ``(s, R)``; freedoms ``(R,)``.

    With the other regressors removed. If too little of a tilt remains, the error is infinite.
    """
    design = design_of(rows[-1:], [True], POWERS)
    basis, values, _ = np.linalg.svd(design, full_matrices=False)
    basis = basis[:, values > values[0] * 1e-9]
    free = states - basis @ (basis.T @ states)
    norm = np.sum(free**2, axis=0)
    enough = norm > LEAST_LEFT * np.sum(states**2, axis=0)
    norm = np.where(enough, norm, 1.0)
    torque = np.mean([sweep.torque[:, still] for sweep in rows], axis=0)  # (m, s)
    power = [np.sum((waves(len(free), 2 * h).T @ free) ** 2, axis=0) for h in range(1, HARMONICS + 1)]
    power[-1] += np.maximum(norm - np.sum(power, axis=0), 0.0)  # what is faster: there is less noise there
    spectrum, freedom = noise.seen_by(np.array(power) / norm)
    error = np.sqrt(noise.variance[still][:, None] * spectrum / (norm * len(rows)))
    return torque.T @ free / norm, np.where(enough, error, np.inf), freedom


def _ratio(size: Array, error: Array) -> Array:
    """Mean over the motors of the squares of size over error ``(R,)``."""
    return np.asarray(np.mean((size / error) ** 2, axis=0))
