"""A fit of gravity and friction to a torque log of 100 000 rows, against a loop over pin's regressor with lstsq.

    python benchmarks/fit_log.py [--rows 100000] [--runs 5]

Both fit the links' masses and first moments and the motors' friction to the same rows. The loop is what such programs
usually are: pin's inverse dynamics and regressor row by row, one least squares over the rows that count; these, the
accelerations and friction's columns are given to it. Ours is timed twice: that one least squares, from the log's
columns to parameters, and the whole stage of `clampid identify`: the fit, outliers, and twice prewhitening by the noise
and the fit again. The designs must span the same space, and the torques of a program that nobody saw must be predicted
equally well.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable
from time import perf_counter, process_time

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
import pinocchio as pin
from virtual_log import rows_of, virtual_log

from clampid.catalogue import catalogue
from clampid.fit import prior_of, start_of
from clampid.fit_log import fit_log
from clampid.identify_folder import STANDARD
from clampid.identify_log import LogStage
from clampid.layout import layout_of
from clampid.priors import description_priors
from clampid.slots import Term
from clampid.stages.log_facts import facts_of, log_parts
from clampid.threads import single_threaded
from experiments.campaign import Campaign, Instrument, Tool
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


def loop_rows(campaign: Campaign, signals: dict[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Stacked design and torque of the rows that count, by pin, row by row and motor by motor."""
    robot, n = campaign.robot, campaign.robot.n
    model, T = pin_model(robot, campaign.tool), np.asarray(campaign.robot.transmission)
    model.gravity.linear = campaign.gravity
    data, table = model.createData(), campaign.tables["free_air"]
    q, qd, tau = (
        table[[f"{k}{i + 1}_{u}" for i in range(n)]].to_numpy()
        for k, u in (("q", "rad"), ("qd", "rad_s"), ("tau", "Nm"))
    )
    used, qdd, friction = signals["used"], signals["qdd"], signals["friction"]
    mass = [10 * k + i for k in range(n) for i in range(4)]
    design, torque = [], []
    for r in range(len(q)):
        Y = T @ pin.computeJointTorqueRegressor(model, data, q[r], qd[r], qdd[r])[:, mass]
        left = tau[r] - T @ pin.rnea(model, data, q[r], qd[r], qdd[r])
        for c in np.flatnonzero(used[r]):
            design.append(np.concatenate([Y[c], friction[r, c]]))
            torque.append(left[c])
    return np.array(design), np.array(torque)


def stage_signals(stage: LogStage) -> dict[str, np.ndarray]:
    """Which numbers the stage uses ``(N, n)``, accelerations and friction's columns, as given things for the loop."""
    n, rows = stage.design.n, stage.facts.rows
    count = len(stage.experiment.slots)
    used, friction = np.zeros((rows, n), dtype=bool), np.zeros((rows, n, count - 4 * n))
    for block in stage.design:
        for c, channel in enumerate(block.channels):
            own = slice(channel.own, None)
            used[channel.row[own], c] = True
            dry = channel.columns >= 4 * n
            where = channel.columns[dry] - 4 * n
            friction[channel.row[own][:, None], c, where] = channel.both[own, :-1][:, dry]
    qdd = accelerations_of(stage)
    return {"used": used, "qdd": qdd, "friction": friction}


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
    precision, mean = prior_of(stage.experiment, priors)
    start = start_of(stage.experiment, None, priors)
    result = fit_log(stage.design, kept, precision, mean, stage.experiment.sizes(), start)
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


def triangular_solution(stage: LogStage) -> np.ndarray:
    """Unweighted least squares ``(P,)``, window by window by QR: the triangles together have all the rows say."""
    triangles = []
    for block in stage.design:
        for channel in block.channels:
            R = np.linalg.qr(channel.both[channel.own :], mode="r")
            full = np.zeros((len(R), stage.design.parameters + 1))
            full[:, [*channel.columns, -1]] = R
            triangles.append(full)
    every = np.concatenate(triangles)
    return np.asarray(np.linalg.lstsq(every[:, :-1], every[:, -1], rcond=None)[0])


def timed(function: Callable[[], object], runs: int) -> tuple[float, float]:
    """Medians of wall and processor time, s."""
    wall, cpu = [], []
    for _ in range(runs):
        a, b = perf_counter(), process_time()
        function()
        wall.append(perf_counter() - a)
        cpu.append(process_time() - b)
    return float(np.median(wall)), float(np.median(cpu))


@single_threaded
def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rows", type=int, default=100_000)
    parser.add_argument("--runs", type=int, default=5)
    asked = parser.parse_args()
    robot = load_robot("kuka_kr20_r1810")
    header, tables = virtual_log(robot)
    tool = Tool(header["tool"]["mass_kg"], np.array(header["tool"]["com_m"]))

    def campaign_of(rows: int) -> Campaign:
        log = {"free_air": rows_of(tables, rows)}
        instrument = Instrument("virtual", 1e-5, None)
        return Campaign("benchmark", None, robot, np.array(header["gravity_m_s2"]), tool, {}, instrument, log, "0" * 64)

    data, unseen = campaign_of(asked.rows), campaign_of(10_000)
    layout, effects, terms = layout_of([data]), catalogue(), [Term(name) for name in STANDARD]

    def stage_of(campaign: Campaign) -> LogStage:
        return LogStage(log_parts([campaign]), layout, effects, terms, False)

    def ours() -> tuple[np.ndarray, int]:
        stage.facts = stage.design.facts = facts_of(stage.parts)
        stage.design.forget()
        return fitted(stage)

    def once() -> np.ndarray:
        stage.facts = stage.design.facts = facts_of(stage.parts)
        stage.design.forget()
        return triangular_solution(stage)

    stage, test = stage_of(data), stage_of(unseen)
    theta, rejected = ours()
    wall, cpu = timed(ours, asked.runs)
    once_wall, once_cpu = timed(once, asked.runs)
    signals = stage_signals(stage)
    start, started = perf_counter(), process_time()
    Y, left = loop_rows(data, signals)
    found = np.linalg.lstsq(Y, left, rcond=None)[0]
    loop_wall, loop_cpu = perf_counter() - start, process_time() - started
    X, torque = stacked(stage)
    first = once()
    loop_left = left - Y @ found
    same = [np.max(np.abs(torque - X @ x - loop_left)) for x in (np.linalg.lstsq(X, torque, rcond=None)[0], first)]
    Y_test, left_test = loop_rows(unseen, stage_signals(test))
    X_test, torque_test = stacked(test)
    errors = [np.std(y - A @ x) for y, A, x in
              ((torque_test, X_test, first), (torque_test, X_test, theta), (left_test, Y_test, found))]  # fmt: skip
    print(f"{asked.rows} rows, {len(X)} torques that count, {X.shape[1]} parameters, {rejected} rows rejected")
    print(f"residuals differ from the loop's by at most {same[0]:.1e} Nm with its own lstsq on our design,")
    print(f"and by at most {same[1]:.1e} Nm with ours; their rms is {loop_left.std():.3f} Nm")
    print(f"{'':34}{'wall':>10}{'processor':>12}{'error on an unseen program':>30}")
    rows = (("clampid, one least squares", once_wall, once_cpu), ("clampid, whole stage", wall, cpu),
            ("loop over pin, lstsq", loop_wall, loop_cpu))  # fmt: skip
    for (name, a, b), error in zip(rows, errors, strict=True):
        print(f"{name:34}{a:8.2f} s{b:10.2f} s{error:27.4f} Nm")
    for name, a, b in rows[:2]:
        print(f"{'ratio to ' + name:34}{loop_wall / a:8.1f}  {loop_cpu / b:10.1f}")


if __name__ == "__main__":
    main()
