"""Models of arms drawn from the catalogue's own sizes, without a measurement: quick, and with every pose effect."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from clampid.catalogue import catalogue
from clampid.effect import Parameter
from clampid.models.model import Model, Session, StageModel
from clampid.slots import Layout, Term, slots_of_terms
from clampid.stages.fit_problem import parameter_of
from kinematics.description import load_robot
from offline_ik.arm.identified import Conditions, IdentifiedArm, arm_of

STANDARD = ("geometry", "joint_compliance", "backlash", "gravity", "wrist_coupling_friction", "thermal_expansion")
CELL = """
format = "clampid-cell/1"
robot = "kuka_kr20_r1810"
gravity_m_s2 = [0.0, 0.0, -9.81]
[convention]
name = "thesis"
beam = [-0.7071067811865476, 0.7071067811865476, 0.0]
sample_m = [1.4, 0.0, 0.0]
[detector]
position_m = [0.0, 0.0, 0.12]
size_m = [0.2, 0.2, 0.1]
[tool]
mass_kg = 12.0
com_m = [0.0, 0.0, 0.08]
[temperature]
link_C = [28.0, 28.0, 27.0, 27.0, 26.0, 26.0]
[[obstacle]]
name = "sample stage"
shape = "box"
size_m = [0.3, 0.3, 0.6]
position_m = [1.4, 0.0, -0.35]
"""
WIND_UP = 4e-3  # rad of a joint at its rated torque
MOUNT = np.array([[0.0, -1.0, 0.0, 0.02], [1.0, 0.0, 0.0, -0.01], [0.0, 0.0, 1.0, 0.12], [0.0, 0.0, 0.0, 1.0]])


def drawn_model(robot: str = "kuka_kr20_r1810", effects: Sequence[str] = STANDARD, seed: int = 0) -> Model:
    """A model whose parameters are drawn from the sizes that the catalogue gives; known to a hundredth of those."""
    rng = np.random.default_rng(seed)
    n = load_robot(robot).n
    layout = Layout(n, ("T1", "T2", "T3"), ("session1",), tuple(range(n - 3, n)))
    terms = tuple(Term(name) for name in effects)
    slots = slots_of_terms(terms, catalogue(), layout, "poses")
    parameters = [parameter_of(slot, catalogue(), load_robot(robot)) for slot in slots]
    size = np.array([parameter.size for parameter in parameters])
    value = np.array([_value(parameter, rng) for parameter in parameters])
    # Sizes are what a fit may find; springs are drawn as stiff as drives are, or the arm would be a rubber band.
    joints = load_robot(robot).joints
    ratio = np.abs(np.diag(np.asarray(load_robot(robot).transmission)))
    rated = np.array([j.rated_torque or 100.0 for j in joints])
    spring = dict(zip((f"joint{i + 1}" for i in range(n)), WIND_UP / rated / ratio**2, strict=True))
    value = np.array([
        spring[slot.place] * rng.uniform(0.6, 1.25) if slot.effect == "joint_compliance" else v
        for slot, v in zip(slots, value, strict=True)
    ])  # fmt: skip
    loose = rng.normal(size=(len(slots), len(slots))) * 0.01
    covariance = (0.01 * size)[:, None] * (np.eye(len(slots)) + loose @ loose.T) * (0.01 * size)
    stage = StageModel("poses", terms, slots, value, covariance, (True,) * len(slots))
    base = np.array([[0.0, -1.0, 0.0, 1.0], [1.0, 0.0, 0.0, 2.0], [0.0, 0.0, 1.0, 0.5], [0.0, 0.0, 0.0, 1.0]])
    session = Session("drawn", "0" * 64, base, ("T1", "T2", "T3"), 12.0, (20.0, 30.0))
    return Model(robot, layout, {"poses": stage}, (session,))


def drawn_arm(robot: str = "kuka_kr20_r1810", effects: Sequence[str] = STANDARD, seed: int = 0) -> IdentifiedArm:
    """The arm of such a model, a tool of 12 kg on it."""
    return arm_of(drawn_model(robot, effects, seed), tool_com=(0.0, 0.0, 0.08))


def conditions(n: int = 6, seed: int = 0) -> Conditions:
    """Directions and temperatures at random."""
    rng = np.random.default_rng(seed)
    return Conditions(np.sign(rng.normal(size=n)), 10 * rng.normal(size=n), 10 * rng.normal(size=n), 60.0)


def postures(arm: IdentifiedArm, count: int, seed: int = 0) -> np.ndarray:
    """Joint values ``(count, n)`` within limits and a turn."""
    rng = np.random.default_rng(seed)
    low, high = np.maximum(arm.robot.lower, -np.pi), np.minimum(arm.robot.upper, np.pi)
    return rng.uniform(low, high, (count, arm.n))


def _value(parameter: Parameter, rng: np.random.Generator) -> float:
    if parameter.shape:
        return parameter.grid[0]
    drawn = 0.5 * parameter.size * rng.normal()
    low, high = parameter.bounds
    return float(np.clip(abs(drawn) if low >= 0 else drawn, low, high))
