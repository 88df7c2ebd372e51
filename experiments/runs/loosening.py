"""Finds a clamp that has become looser: the torques of the standing motors in a sweep differ from those of before.

The same joint is driven over the same steps again. Block, springs and friction then repeat their torques. Between two
sweeps of one clamping a standing motor's torque differs only by a constant, a drift and noise
(`experiments.runs.sweep_noise`). With d the mean over a joint's last sweeps less the mean over those before, and
w the waves of h = 1, 2 periods per loop,

    F = mean over joints, standing motors, h and w of (w·d)² / (power of the noise at h · (1/last + 1/before))

follows Fisher's distribution. The last one, two, four, ... sweeps are taken together, whatever joints they drive. A
block that rocks, or a loose bolt, adds a torque that follows the load: mostly h = 1, and h = 2 if it rests longer on
one side. The flange must also move in the direction of the load.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy import stats

from experiments.plans.motion import Array
from experiments.runs.slips import SweepRows
from experiments.runs.sweep_noise import Noise, alike, line, noise_of, waves
from experiments.runs.yielding import flange_shift, push_of
from kinematics.description import RobotDescription

__all__ = ["Loosening", "find_loosening"]

HARMONICS = 2


@dataclass(frozen=True)
class Loosening:
    """A clamp that gives way more than before.

    Attributes
    ----------
    first, last
        Numbers of the sweeps that show it together.
    before
        Number of the last sweep that they are compared with.
    size
        About how much farther the flange moves from end to end, m, with springs as described.
    p_value
        Over all that is asked in the run.
    """

    first: int
    last: int
    before: int
    size: float
    p_value: float


def find_loosening(
    sweeps: Sequence[SweepRows],
    robot: RobotDescription,
    stiffness: Array,
    jacobian: Array,
    joints: Sequence[int],
    *,
    looks: int = 1,
    level: float,
) -> Loosening | None:
    """Whether the last sweeps of a clamping differ from earlier sweeps of the same joints.

    Parameters
    ----------
    sweeps
        All of this clamping, in order.
    stiffness
        Of the drives as described, Nm/rad at the motors, ``(n,)``.
    jacobian
        ``(6, n)`` of the flange in the clamped posture.
    joints
        Which joint each of them drives, from 0.
    looks
        How often the run makes this test.
    level
        Probability of a false alarm in all of these tests.
    """
    noise = noise_of([s for s in sweeps if len(s.time) == len(sweeps[-1].time)], HARMONICS)
    if noise is None:
        return None
    freedom = float((HARMONICS / np.sum(noise.freedom**-0.5)) ** 2)
    windows = [2**k for k in range((len(sweeps) - 1).bit_length()) if 2**k < len(sweeps)]
    found: Loosening | None = None
    for window in windows:
        changes = list(_changes(sweeps, joints, len(sweeps) - window))
        shares = [_shares(change, noise) for change in changes]
        if not shares:
            continue
        every = np.concatenate([share.ravel() for share in shares])
        p = float(stats.f.sf(every.mean(), every.size, freedom)) * looks * len(windows)
        if p > level or (found is not None and p >= found.p_value):
            continue
        work, size = 0.0, 0.0
        for change in changes:
            error = np.sqrt(noise.variance[change.still] * noise.spectrum[0] * change.more)
            moved = flange_shift(change.curve, error, change.still, robot, stiffness, jacobian)  # (m, 3)
            work += float(change.offset @ moved @ push_of(robot, stiffness, jacobian, change.joint))
            size = max(size, float(np.ptp(moved @ np.linalg.svd(moved, full_matrices=False)[2][0])))
        if work > 0.0:
            last = max(change.before for change in changes)
            found = Loosening(sweeps[-window].number, sweeps[-1].number, last, size, p)
    return found


@dataclass(frozen=True, eq=False)
class _Change:
    """Of one joint: standing motors, the waves' parts ``(H, 2, s)``, Nm, their sum ``(m, s)``, 1/last + 1/before."""

    joint: int
    before: int
    offset: Array
    still: npt.NDArray[np.int64]
    parts: Array
    curve: Array
    more: float


def _changes(sweeps: Sequence[SweepRows], joints: Sequence[int], begin: int) -> Iterator[_Change]:
    """What has changed for each joint that was driven from a sweep on, and before it."""
    count = len(sweeps[-1].time)
    drift = line(count)
    for k, joint in enumerate(joints[begin:], begin):
        if joint in joints[k + 1 :] or len(sweeps[k].time) != count:
            continue
        same = [i for i, sweep in enumerate(sweeps) if alike(sweep, sweeps[k]) and joints[i] == joint]
        before, last = [i for i in same if i < begin], [i for i in same if i >= begin]
        still = np.flatnonzero(~sweeps[k].turned).astype(np.int64)
        if not before or not len(still):
            continue
        means = [np.mean([sweeps[i].torque[:, still] for i in part], axis=0) for part in (last, before)]
        change = means[0] - means[1]
        parts, curve = [], np.zeros_like(change)
        for h in range(1, HARMONICS + 1):
            wave = waves(count, 2 * h)
            wave = np.linalg.qr(wave - drift @ (drift.T @ wave))[0]
            parts.append(wave.T @ change)
            curve += wave @ parts[-1]
        more = 1.0 / len(last) + 1.0 / len(before)
        yield _Change(joint, sweeps[before[-1]].number, sweeps[k].offset, still, np.array(parts), curve, more)


def _shares(change: _Change, noise: Noise) -> Array:
    """Squares of the parts over their variances ``(H, 2, s)``."""
    power = noise.spectrum[:, None, None] * noise.variance[change.still] * change.more
    return np.asarray(change.parts**2 / power)
