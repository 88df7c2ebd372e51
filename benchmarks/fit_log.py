"""A fit of gravity and friction to a torque log of 100 000 rows, against a loop over pin's regressor with lstsq.

    python benchmarks/fit_log.py [--rows 100000] [--runs 5]

Both fit the links' masses and first moments and the motors' friction to the same rows. The loop is written twice: as
such programs usually are, row by row to the end (regressor, transmission, the rows that count appended to lists), and
with care: of rows that count only, into an array made before, everything but the call of pin for all rows together.
Which rows count, accelerations and friction's columns are given to both loops; ours finds them within its time.

Equal results are compared. One least squares: from the log's columns to parameters; designs must span the same space.
The whole stage of `clampid identify`: the same, outliers, prewhitening by the noise and the fit again, and once more
where that changes the noise; after
the careful loop that is done with the stage's own filter and three times lstsq.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable
from dataclasses import dataclass
from time import perf_counter, process_time

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
import pinocchio as pin
from virtual_log import rows_of, virtual_log

from clampid.catalogue import catalogue
from clampid.fitting.fit_log import LogNoise, LogPrior, fit_log, summed
from clampid.fitting.prior_and_start import prior_of, start_of
from clampid.fitting.priors import description_priors
from clampid.fitting.solve import limits_of
from clampid.identification.identify_log import LogStage
from clampid.slots import Term
from clampid.stages.layout import layout_of
from clampid.stages.log_facts import facts_of, log_parts
from clampid.stages.prewhitening import Predictors, Whitener, autocorrelation, lag_products, settled
from clampid.standard_sets import STANDARD
from clampid.threads import single_threaded
from experiments.campaign import Campaign, Tool
from experiments.signals import segments
from experiments.simulate import declared_campaign
from kinematics.description import load_robot
from kinematics.robot import RobotDescription


def pin_model(robot: RobotDescription, tool: Tool) -> pin.Model:
    """The described arm with the declared tool, joints' frames in base axes at the zero pose."""
    model, parent, last = pin.Model(), 0, np.zeros(3)
    for joint, link in zip(robot.joints, robot.links, strict=True):
        kind = pin.JointModelRevoluteUnaligned(np.array(joint.axis))
        parent = model.addJoint(parent, kind, pin.SE3(np.eye(3), joint.point - last), joint.name)
        inertia = np.zeros((3, 3)) if link.inertia is None else np.array(link.inertia)
        body = pin.Inertia(link.mass, link.com - joint.point, inertia)
        model.appendBodyToJoint(parent, body, pin.SE3.Identity())
        last = joint.point
    at = robot.flange[:3, :3] @ tool.com + robot.flange[:3, 3] - last
    model.appendBodyToJoint(parent, pin.Inertia(tool.mass, at, np.zeros((3, 3))), pin.SE3.Identity())
    return model


@dataclass(frozen=True)
class Given:
    """A log as the loops read it ``(N, n)``, with what is given to them."""

    q: np.ndarray
    qd: np.ndarray
    tau: np.ndarray
    qdd: np.ndarray
    used: np.ndarray
    friction: np.ndarray
    stretch: np.ndarray


def usual_loop(campaign: Campaign, log: Given) -> tuple[np.ndarray, np.ndarray]:
    """Stacked design and torque of the rows that count, by pin, row by row and motor by motor."""
    n, T = campaign.robot.n, np.asarray(campaign.robot.transmission)
    model = pin_model(campaign.robot, campaign.tool)
    model.gravity.linear = campaign.gravity
    data = model.createData()
    mass = [10 * k + i for k in range(n) for i in range(4)]
    design, torque = [], []
    for r in range(len(log.q)):
        Y = T @ pin.computeJointTorqueRegressor(model, data, log.q[r], log.qd[r], log.qdd[r])[:, mass]
        left = log.tau[r] - T @ pin.rnea(model, data, log.q[r], log.qd[r], log.qdd[r])
        for c in np.flatnonzero(log.used[r]):
            design.append(np.concatenate([Y[c], log.friction[r, c]]))
            torque.append(left[c])
    return np.array(design), np.array(torque)


def careful_loop(campaign: Campaign, log: Given) -> tuple[np.ndarray, np.ndarray]:
    """The same, with nothing in the loop but pin."""
    n, T = campaign.robot.n, np.asarray(campaign.robot.transmission)
    model = pin_model(campaign.robot, campaign.tool)
    model.gravity.linear = campaign.gravity
    data = model.createData()
    mass = [10 * k + i for k in range(n) for i in range(4)]
    described = np.concatenate([body.toDynamicParameters() for body in model.inertias[1:]])
    rows = np.flatnonzero(log.used.any(axis=1))
    used, Y = log.used[rows], np.empty((len(rows), n, 10 * n))
    for i, r in enumerate(rows):
        Y[i] = pin.computeJointTorqueRegressor(model, data, log.q[r], log.qd[r], log.qdd[r])
    left = log.tau[rows] - (Y @ described) @ T.T
    design = np.concatenate([(T @ Y[:, :, mass])[used], log.friction[rows][used]], axis=1)
    return design, left[used]


def whole_procedure(design: np.ndarray, torque: np.ndarray, log: Given) -> np.ndarray:
    """Least squares ``(P,)``, and up to twice again, weighted by the noise that is left: as the stage does."""
    row, motor = np.nonzero(log.used)
    found = np.linalg.lstsq(design, torque, rcond=None)[0]
    before: list[tuple[float, np.ndarray]] = []
    for _ in range(2):
        residual = torque - design @ found
        sums = [
            lag_products(residual[o], row[o], log.stretch[row[o]]) for o in (motor == c for c in range(motor.max() + 1))
        ]
        noise = [(float(np.sqrt(p[0] / k[0])), autocorrelation(p, k)) for p, k in sums]
        if before and all(
            settled(b[0] / a[0], a[1], b[1], k[0]) for a, b, (_, k) in zip(before, noise, sums, strict=True)
        ):
            break
        before, both = noise, np.c_[design, torque]
        for c, (sigma, correlation) in enumerate(noise):
            own = motor == c
            white = Whitener(row[own], log.stretch[row[own]])
            both[own] = white(both[own], Predictors(correlation)) / sigma
        found = np.linalg.lstsq(both[:, :-1], both[:, -1], rcond=None)[0]
    return found


def given(stage: LogStage) -> Given:
    """The log of a stage with what is given to the loops."""
    n, rows = stage.design.n, stage.facts.rows
    count = len(stage.problem.slots)
    used, friction = np.zeros((rows, n), dtype=bool), np.zeros((rows, n, count - 4 * n))
    for block in stage.design:
        for c, channel in enumerate(block.channels):
            own = slice(channel.own, None)
            used[channel.row[own], c] = True
            dry = channel.columns >= 4 * n
            where = channel.columns[dry] - 4 * n
            friction[channel.row[own][:, None], c, where] = channel.both[own, :-1][:, dry]
    table = stage.parts[0].table.source
    q, qd, tau = (
        table[[f"{k}{i + 1}_{u}" for i in range(n)]].to_numpy()
        for k, u in (("q", "rad"), ("qd", "rad_s"), ("tau", "Nm"))
    )
    stretch = segments(table["run"].to_numpy(), table["time_s"].to_numpy(), np.ones(rows, dtype=bool))
    return Given(q, qd, tau, accelerations_of(stage), used, friction, stretch)


def accelerations_of(stage: LogStage) -> np.ndarray:
    """Accelerations ``(N, n)`` of the log, rad/s²."""
    from clampid.stages.log_facts import WINDOW
    from experiments.log_windows import windows

    motions = stage.facts.motions
    parts = [
        motions.of(0, w).acceleration[w.start : w.stop]
        for w in windows(stage.parts[0].table, motions.columns, WINDOW, stage.facts.halo)
    ]
    return np.concatenate(parts)


def fitted(stage: LogStage) -> tuple[np.ndarray, int]:
    """The stage's parameters by its whole procedure, and how many rows were rejected."""
    kept = np.ones(len(stage.folds), dtype=bool)
    priors = description_priors(stage.folds)
    prior = LogPrior(*prior_of(stage.problem, priors), limits_of(stage.problem))
    result = fit_log(stage.design, kept, prior, start_of(stage.problem, None, priors))
    return result.moments.at, len(result.outliers)


def stacked(stage: LogStage) -> tuple[np.ndarray, np.ndarray]:
    """Design ``(M, P)`` and torque ``(M,)`` of all rows that count, in the loop's order."""
    design, torque, order = [], [], []
    for block in stage.design:
        for c, channel in enumerate(block.channels):
            full = np.zeros((len(channel.row) - channel.own, stage.design.parameters))
            full[:, channel.columns] = channel.both[channel.own :, :-1]
            design.append(full)
            torque.append(channel.both[channel.own :, -1])
            order.append(channel.row[channel.own :] * stage.design.n + c)
    index = np.argsort(np.concatenate(order))
    return np.concatenate(design)[index], np.concatenate(torque)[index]


def least_squares(stage: LogStage) -> np.ndarray:
    """Unweighted least squares ``(P,)`` from the sums that the package fits by; where rows say nothing, zero.

    Balanced columns have normal equations of condition 1e9 here; ones that are rounding alone count as zero.
    """
    every, none = np.ones(len(stage.folds), dtype=bool), np.zeros(0, dtype=np.int64)
    sums = summed(stage.design, every, none, LogNoise(np.ones(stage.design.n)))[0]
    length = np.sqrt(np.diag(sums.normal))
    balance = np.where(length > 1e-12 * length.max(), 1.0 / np.maximum(length, 1e-300), 0.0)
    scaled = sums.normal * np.outer(balance, balance)
    return np.asarray(balance * np.linalg.lstsq(scaled, balance * sums.slope, rcond=1e-12)[0])


def timed(function: Callable[[], object], runs: int) -> tuple[float, float]:
    """Wall and processor time of the fastest run, s: what else a machine does only adds to it."""
    wall, cpu = [], []
    for _ in range(runs):
        a, b = perf_counter(), process_time()
        function()
        wall.append(perf_counter() - a)
        cpu.append(process_time() - b)
    return min(wall), min(cpu)


@single_threaded
def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rows", type=int, default=100_000)
    parser.add_argument("--runs", type=int, default=5)
    asked = parser.parse_args()
    robot = load_robot("kuka_kr20_r1810")
    header, tables = virtual_log(robot)
    data, unseen = (declared_campaign(header, {"free_air": rows_of(tables, k)}, robot) for k in (asked.rows, 10_000))
    layout, effects, terms = layout_of([data]), catalogue(), [Term(name) for name in STANDARD["free_air"]]

    def stage_of(campaign: Campaign) -> LogStage:
        return LogStage(log_parts([campaign]), layout, effects, terms)

    def ours() -> tuple[np.ndarray, int]:
        stage.facts = stage.design.facts = facts_of(stage.parts)
        stage.design.forget()
        return fitted(stage)

    def once() -> np.ndarray:
        stage.facts = stage.design.facts = facts_of(stage.parts)
        stage.design.forget()
        return least_squares(stage)

    stage, test = stage_of(data), stage_of(unseen)
    theta, rejected = ours()
    wall, cpu = timed(ours, asked.runs)
    once_wall, once_cpu = timed(once, asked.runs)
    log, test_log = given(stage), given(test)
    usual_wall, usual_cpu = timed(lambda: np.linalg.lstsq(*usual_loop(data, log), rcond=None), 1)
    loop_wall, loop_cpu = timed(lambda: np.linalg.lstsq(*careful_loop(data, log), rcond=None), asked.runs)
    Y, left = careful_loop(data, log)
    again_wall, again_cpu = timed(lambda: whole_procedure(Y, left, log), asked.runs)
    lstsq_wall, lstsq_cpu = timed(lambda: np.linalg.lstsq(Y, left, rcond=None), 1)
    whole_wall, whole_cpu = loop_wall + again_wall - lstsq_wall, loop_cpu + again_cpu - lstsq_cpu
    found, whole = np.linalg.lstsq(Y, left, rcond=None)[0], whole_procedure(Y, left, log)
    X, torque = stacked(stage)
    first, loop_left = once(), left - Y @ found
    solved = np.linalg.lstsq(X, torque, rcond=None)[0]
    same = [np.max(np.abs(torque - X @ x - r)) for x, r in
            ((solved, loop_left), (first, loop_left), (theta, left - Y @ whole))]  # fmt: skip
    (Y_test, left_test), (X_test, torque_test) = careful_loop(unseen, test_log), stacked(test)
    errors = [np.std(y - A @ x) for y, A, x in
              ((torque_test, X_test, first), (left_test, Y_test, found), (left_test, Y_test, found),
               (torque_test, X_test, theta), (left_test, Y_test, whole))]  # fmt: skip
    print(f"{asked.rows} rows, {len(X)} torques that count, {X.shape[1]} parameters, {rejected} rows rejected")
    print(f"residuals of one least squares differ by at most {same[0]:.1e} Nm with lstsq on our design, and by at most")
    print(f"{same[1]:.1e} Nm with ours; of the whole stage by {same[2]:.1e} Nm; their rms is {loop_left.std():.3f} Nm")
    print(f"{'':34}{'wall':>10}{'processor':>12}{'ratio: wall, processor':>26}{'error, unseen program':>24}")
    rows = (("one least squares, clampid", once_wall, once_cpu, once_wall, once_cpu),
            ("  usual loop over pin, lstsq", usual_wall, usual_cpu, once_wall, once_cpu),
            ("  careful loop over pin, lstsq", loop_wall, loop_cpu, once_wall, once_cpu),
            ("whole stage, clampid", wall, cpu, wall, cpu),
            ("  careful loop, the same after", whole_wall, whole_cpu, wall, cpu))  # fmt: skip
    for (name, a, b, of_wall, of_cpu), error in zip(rows, errors, strict=True):
        print(f"{name:34}{a:8.2f} s{b:10.2f} s{a / of_wall:16.1f}{b / of_cpu:10.1f}{error:21.4f} Nm")


if __name__ == "__main__":
    main()
