"""What a test that knows all but the cause would find in the trials of the second world.

    python benchmarks/hidden_oracle.py OUT/results.jsonl [--stages poses,free_air]

`OUT` is that of `hidden_effects.py`. The test knows the noise with its covariance, the robot, and how the measurement
changes by each effect of this world at each place, so that one size is left to find for each. Standard parameters are
fitted. The effect that explains most is named where this is more than chance gives with the largest of all (1 %). No
diagnosis reaches that, which has to learn noise and robot from the same rows. But it shows what is there to be found.

Prints of each trial: the squares, in units of variance, that the effect adds beyond the standard parameters; the two
effects that are most like it (cos²); how often the test names it, in 4000 draws of the noise; whether `diagnose` was
right. A hit is as in the benchmark: one of the first three, or the first if it is outside the library. Logs with pink
noise or a walk over more than 18 000 samples are passed over: the covariance would be too large.

With `--level-unknown` the test does not know from where the torques' slow noise began. This world draws it from about
zero, so that any constant would be an effect. On a real sensor nobody knows.
"""

from __future__ import annotations

import argparse
import json
import os
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from hidden_second import SECOND_FAMILIES, SECOND_OUTSIDE, SecondBench
from hidden_table import untestable
from hidden_trial import MOST_ALTERNATIVES
from scipy import linalg, stats

from experiments.second_world.arrays import Array
from experiments.second_world.hidden import HIDDEN, Active
from experiments.second_world.noise import covariance
from experiments.second_world.session import Session, activate, open_session, points_seen, torques
from experiments.second_world.sizing import beyond, standard_pose_columns, standard_torque_columns

DRAWS = 4000
FALSE_ALARMS = 0.01
MOST_SAMPLES = 18000  # of a log with correlated noise: 8 GB, and a minute
NUDGE, ABSORBED = 1e-5, 1e-7
CASES = (*SECOND_FAMILIES, *SECOND_OUTSIDE)


@dataclass(frozen=True)
class View:
    """A table as the test sees it.

    Attributes
    ----------
    standard
        Whitened derivatives ``(M, p)`` by the standard parameters.
    change
        Whitened change ``(M,)`` of the measurement by effects in force.
    """

    standard: Array
    change: Callable[[Sequence[Active]], Array]


def poses_of(session: Session) -> View:
    """The table of poses: noise of instrument and joints, the latter shared by the targets of a visit."""
    visits, noise = session.visits, session.noise
    plain = points_seen(session, visits, [])
    N, K, _ = plain.shape
    n = session.robot.n
    by_joint = np.stack(
        [points_seen(session, visits, [], NUDGE * np.eye(n)[j] * np.ones((N, 1))) - plain for j in range(n)], -1
    )
    levers = by_joint.reshape(N, 3 * K, n) / NUDGE
    jitter = np.broadcast_to(session.robot.repeatability_rad, n) ** 2 + noise.count_rad**2 / 12.0
    whole = np.zeros((N, K, 3, N, K, 3))
    of_one = covariance(noise, np.repeat(np.arange(float(N)), K))
    for a, std in enumerate(session.instrument.std_m):
        numbers = std**2 * of_one + noise.position_step_m**2 / 12.0 * np.eye(N * K)
        whole[:, :, a, :, :, a] = numbers.reshape(N, K, N, K)
    flat = whole.reshape(N, 3 * K, N, 3 * K)
    for v in range(N):
        flat[v, :, v] += (levers[v] * jitter) @ levers[v].T
    L = linalg.cholesky(whole.reshape(3 * N * K, -1), lower=True)

    def whitened(columns: Array) -> Array:
        return np.asarray(linalg.solve_triangular(L, columns, lower=True))

    return View(
        whitened(standard_pose_columns(session).reshape(plain.size, -1)),
        lambda laws: whitened((points_seen(session, visits, laws) - plain).ravel()),
    )


def torques_of(session: Session, level_unknown: bool) -> View | None:
    """The log of free air; None if its noise is correlated over too many samples."""
    plain, noise = torques(session, session.motion, []), session.noise
    samples, n = plain.shape
    time, step = np.arange(float(samples)), noise.torque_step**2 / 12.0
    L = None
    if noise.has_slow_part:
        if samples > MOST_SAMPLES:
            return None
        whole = covariance(noise, time, earlier=level_unknown)
        whole[np.diag_indices(samples)] += step
        L = linalg.cholesky(whole, lower=True, overwrite_a=True)
    spread = 1.0 if L is not None else np.sqrt(covariance(noise, time[:1])[0, 0] + step)

    def whitened(columns: Array) -> Array:
        of_motors = np.moveaxis(columns.reshape(samples, n, -1), 1, 0) / session.robot.torque_std_Nm[:, None, None]
        parts = [x / spread if L is None else linalg.solve_triangular(L, x, lower=True) for x in of_motors]
        return np.concatenate(parts)

    standard = standard_torque_columns(session, list(range(samples))).reshape(plain.size, -1)
    return View(
        whitened(standard), lambda laws: whitened((torques(session, session.motion, laws) - plain).ravel())[:, 0]
    )


def judged(row: dict[str, Any], level_unknown: bool) -> dict[str, Any] | None:
    """What the test finds in the trial of a line of results; None where it is passed over."""
    case = next(c for c in CASES if c.label == row["case"])
    with tempfile.TemporaryDirectory() as folder:
        bench = SecondBench(case, row["seed"], 0, Path(folder))
        magnitude, size = bench.magnitude(case.hidden[0], row["size"])
    session, name, where = open_session(bench.robot, **bench.session), case.hidden[0], bench.places()[0]
    view = poses_of(session) if case.stage == "poses" else torques_of(session, level_unknown)
    if view is None:
        return None
    rivals = [
        (other.hidden[0], place)
        for other in CASES
        if other.stage == case.stage
        for place in HIDDEN[other.hidden[0]].places(session.robot.n)
        if (other.hidden[0], place) != (name, where)
    ]
    asked = [(name, where, magnitude), *((other, place, 1.0) for other, place in rivals)]
    columns = np.stack([view.change([law]) for *_, law in activate(session, asked)], axis=1)
    shown = np.linalg.norm(columns, axis=0)
    columns = beyond(columns, view.standard)
    left = np.linalg.norm(columns, axis=0)
    able = left > ABSORBED * np.maximum(shown, 1e-300)
    if not able[0]:
        return None
    directions = columns[:, able] / left[able]
    gram = directions.T @ directions
    values, vectors = np.linalg.eigh(gram)
    chance = (
        np.random.default_rng(0).standard_normal((DRAWS, len(values))) @ (vectors * np.sqrt(np.maximum(values, 0))).T
    )
    explained = (left[0] * gram[0] + chance) ** 2
    enough = stats.chi2.isf(FALSE_ALARMS / len(values), 1)
    ahead = (explained > explained[:, :1]).sum(axis=1)
    hit = (explained[:, 0] > enough) & (ahead < (1 if case.depends_on else MOST_ALTERNATIVES))
    like = np.argsort(-(gram[0] ** 2))[1:3]
    labels = [f"{other}@{place}" for keep, (other, place) in zip(able[1:], rivals, strict=True) if keep]
    return {
        "case": row["case"],
        "seed": row["seed"],
        "noise": session.noise_name,
        "size": size,
        "squares": float(left[0] ** 2),
        "like": [(labels[k - 1], round(float(gram[0, k] ** 2), 2)) for k in like],
        "named": float(hit.mean()),
        "diagnosed": row["right"],
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("results", type=Path)
    parser.add_argument("--stages", default="poses,free_air")
    parser.add_argument("--level-unknown", action="store_true", help="of the torques' slow noise")
    options = parser.parse_args()
    lines = [json.loads(line) for line in options.results.read_text().splitlines()]
    wanted = [r for r in lines if r.get("world") == "second" and r["kind"] in ("single", "outside")]
    found = []
    for row in (r for r in wanted if r["stage"] in options.stages.split(",") and not untestable(r)):
        one = judged(row, options.level_unknown)
        print(f"{row['case']} {row['seed']}: passed over" if one is None else json.dumps(one), flush=True)
        found += [] if one is None else [one]
    print(
        f"\n{len(found)} trials: {sum(r['named'] for r in found):.1f} named by the test that knows all but the cause,"
    )
    print(f"{sum(r['diagnosed'] for r in found)} by the diagnosis")


if __name__ == "__main__":
    main()
