"""Motor currents of a TX40: R² on the last fifth of the log, for several laws of friction at rest.

The first four fifths are fitted, the last is predicted. Rigid-body dynamics, rotors, viscous, Coulomb and slow dry
friction are least squares with a ridge; dry friction follows the sign of motion, or a state (`presliding_friction`) of
one of several lengths and times. Ridge and length are chosen on the first four fifths alone, by leaving out contiguous
blocks. In these rows no joint rests for longer than 0.07 s, so that they cannot tell a time of relaxation between 0.1
and 10 s: the prediction is then the mean over the times, each as likely as the next. The log has motor 6's angle over
its ratio for q6, so joint 5's share is taken off first.

Two footings: currents low-passed at 50 Hz without lag (drives vibrate at 100 to 250 Hz), and the currents as logged.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.signal import butter, filtfilt

from clampid.catalogue import catalogue
from clampid.effect import PRESLIDING_LENGTHS, RELAXATION_TIMES
from clampid.identification.identify import stage_rows
from clampid.slots import Term, slots_of_terms
from clampid.stages.fit_problem import fit_problem
from clampid.stages.layout import layout_of
from clampid.stages.rows import Array, Bools, Rows
from experiments.campaign import Campaign, read_campaign

BAR = (0.923, 0.900, 0.884, 0.868, 0.829, 0.808)
PASSED_HZ = 50.0
EVERY = 20  # rows: 250 Hz
BLOCKS = 5
RIDGES = (1e-3, 1e-2, 1e-1)
SLOW = 20.0  # rad/s at the motor, over which dry friction falls with speed
REST = 1.0  # rad/s at the motor, over which the sign of motion is smoothed where friction at rest is none


@dataclass(frozen=True)
class Log:
    """Currents ``(N, n)`` low-passed and as logged, their regressor ``(N, n, P)``, and which rows are fitted."""

    smooth: Array
    logged: Array
    regressor: Array
    rows: Rows
    fitted: Bools


@dataclass(frozen=True)
class Result:
    """A law of friction at rest: its error by block, in units of the currents' variance, and its prediction."""

    name: str
    blocks: Array
    predicted: Array
    left_out: Array  # (N, n), predictions of the fitted rows by fits without their block; else zero


def read(folder: Path) -> Log:
    """Read the log and prepare it."""
    campaign = read_campaign(folder)
    table, n = campaign.tables["free_air"].copy(), campaign.robot.n
    Q, TAU = [f"q{i + 1}_rad" for i in range(n)], [f"tau{i + 1}_Nm" for i in range(n)]
    table["q6_rad"] -= table["q5_rad"]
    step = float(np.median(np.diff(table["time_s"])))
    logged = table[TAU].to_numpy(float)
    table[Q + TAU] = filtfilt(*butter(4, 2.0 * PASSED_HZ * step), table[Q + TAU].to_numpy(float), axis=0)
    thinned = table.iloc[::EVERY].reset_index(drop=True)
    rows, regressor = _design(replace(campaign, tables={"free_air": thinned}))
    return Log(rows.measured, logged[::EVERY], regressor, rows, rows.fold < rows.fold.max())


def _design(campaign: Campaign) -> tuple[Rows, Array]:
    effects, layout = catalogue(), layout_of([campaign])
    rows = stage_rows([campaign], layout, "free_air", active=[effects["inertia"], effects["presliding_friction"]])
    terms = [Term(name) for name in ("gravity", "inertia", "link_inertia")]
    slots = slots_of_terms(terms, effects, layout, rows.stage)
    _, jacobian = fit_problem(rows, effects, slots).residual(np.zeros(len(slots)))
    return rows, jacobian[:, :, : len(slots)]


def laws(rows: Rows) -> Iterator[tuple[str, float | None, Array]]:
    """Names of laws of dry friction, their lengths in rad where they have one, and their states ``(N, n)``."""
    w, states = rows.signals["motor_speed"], rows.signals["dry_state"]
    yield "none at rest", None, np.tanh(w / REST)
    yield "held from the last motion", None, rows.signals["motor_motion"]
    for k, (s, t) in enumerate((s, t) for s in PRESLIDING_LENGTHS for t in RELAXATION_TIMES):
        yield f"state, {1e3 * s:g} mrad, {t:g} s", s, states[:, :, k]


def judge(log: Log, name: str, state: Array) -> Result:
    """Fit a law with the ridge that the blocks left out like best."""
    w, scale = log.rows.signals["motor_speed"], log.smooth[log.fitted].std(axis=0)
    n, P = w.shape[1], log.regressor.shape[2]
    design = np.zeros((len(w), n, P + 3 * n))
    design[:, :, :P] = log.regressor
    for m in range(n):
        z = state[:, m]
        design[:, m, P + 3 * m : P + 3 * m + 3] = np.column_stack([w[:, m], z, z * np.exp(-np.abs(w[:, m]) / SLOW)])
    design /= scale[:, None]
    design /= np.sqrt((design[log.fitted] ** 2).sum(axis=(0, 1))) + 1e-12
    target = log.smooth / scale
    block = blocks_of(log.fitted)
    A = np.array([np.einsum("imp,imq->pq", design[block == b], design[block == b]) for b in range(BLOCKS)])
    g = np.array([np.einsum("imp,im->p", design[block == b], target[block == b]) for b in range(BLOCKS)])
    best: Result | None = None
    for ridge in RIDGES:
        damping = ridge * np.eye(A.shape[1])
        left_out = np.zeros_like(target)
        for b in range(BLOCKS):
            left_out[block == b] = design[block == b] @ np.linalg.solve(A.sum(0) - A[b] + damping, g.sum(0) - g[b])
        errors = block_errors(target, left_out, log.fitted)
        if best is None or errors.mean() < best.blocks.mean():
            predicted = design @ np.linalg.solve(A.sum(0) + damping, g.sum(0)) * scale
            best = Result(name, errors, predicted, left_out * scale)
    assert best is not None
    return best


def blocks_of(fitted: Bools) -> NDArray[np.int64]:
    """The block ``(N,)`` of every fitted row; -1 for the rows that are predicted."""
    return np.where(fitted, (np.cumsum(fitted) - 1) * BLOCKS // fitted.sum(), -1)


def block_errors(target: Array, left_out: Array, fitted: Bools) -> Array:
    """Mean squares ``(BLOCKS,)`` of what was predicted without its block, in the unit of the target."""
    block = blocks_of(fitted)
    return np.array([np.mean((target[block == b] - left_out[block == b]) ** 2) for b in range(BLOCKS)])


def averaged(log: Log, name: str, results: Sequence[Result]) -> Result:
    """The mean prediction of laws that the fitted rows cannot distinguish, each as likely as the next."""
    scale = log.smooth[log.fitted].std(axis=0)
    left_out = np.mean([r.left_out for r in results], axis=0)
    errors = block_errors(log.smooth / scale, left_out / scale, log.fitted)
    return Result(name, errors, np.mean([r.predicted for r in results], axis=0), left_out)


def judged(log: Log) -> tuple[list[Result], Result]:
    """Every law, then the mean over the times of each length, and which of these the fitted rows like best."""
    results: list[Result] = []
    by_length: dict[float, list[Result]] = {}
    for name, length, state in laws(log.rows):
        results.append(judge(log, name, state))
        if length is not None:
            by_length.setdefault(length, []).append(results[-1])
    means = [averaged(log, f"state, {1e3 * s:g} mrad, all times", of) for s, of in by_length.items()]
    return [*results, *means], min(means, key=lambda r: float(r.blocks.mean()))


def r_squared(measured: Array, predicted: Array) -> Array:
    """R² by column."""
    return np.asarray(1.0 - ((measured - predicted) ** 2).sum(0) / ((measured - measured.mean(0)) ** 2).sum(0))


def main() -> None:
    """Print a line per law."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("campaign", type=Path, help="folder of the log")
    log = read(parser.parse_args().campaign)
    test = ~log.fitted
    results, chosen = judged(log)
    print(f"{'dry friction':28}{'left out':>10}{'difference':>18}   R² low-passed, joints 1 to 6; as logged")
    for r in results:
        gap = r.blocks - chosen.blocks
        error = gap.std(ddof=1) / np.sqrt(BLOCKS)
        shown = [r_squared(y[test], r.predicted[test]) for y in (log.smooth, log.logged)]
        words = "; ".join(" ".join(f"{v:.3f}" for v in values) for values in shown)
        met = "".join("x" if v > bar else "-" for v, bar in zip(shown[0], BAR, strict=True))
        mark = "*" if r is chosen else " "
        print(f"{mark}{r.name:27}{r.blocks.mean():10.5f}{gap.mean():10.5f} ±{error:.5f}   {words}  {met}")
    ceiling = r_squared(log.logged[test], log.smooth[test])
    print("R² of the low-passed currents themselves on those as logged: " + " ".join(f"{v:.3f}" for v in ceiling))
    print("asked for:                                                   " + " ".join(f"{v:.3f}" for v in BAR))


if __name__ == "__main__":
    main()
