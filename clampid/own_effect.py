"""What is refused of a user's own effect when it is loaded, because a fit with it would give wrong numbers.

Zero amplitudes mean that the effect is absent: a deviation that stays at zero amplitudes shifts base and geometry
instead of showing itself. And it must act where its stage measures something: elsewhere it does nothing, unnoticed.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import SimpleNamespace
from typing import Any

import casadi as ca
import numpy as np

from clampid.effect import STATIONS, Effect, EffectError, Stage, signal
from clampid.slots import Layout

__all__ = ["OUTPUTS_OF_STAGES", "SIGNALS_NOT_READ", "check_own_effect"]

OUTPUTS_OF_STAGES: Mapping[Stage, tuple[str, ...]] = {
    "free_air": ("joint_torque", "motor_torque", "friction_state"),
    "clamped": ("joint_angle", "fixture", "motor_torque", "joint_torque"),
    "poses": ("joint_angle", "base_twist", "link_twist", "target_shift", "measurement", "joint_torque"),
}
"""The stations whose deviations a stage can show; in poses torques at joints are loads on springs."""
_OF_POSES = (
    "anchor_is", "anchor_way", "base_moment", "direction", "link_force", "link_moment", "position", "reversal_way",
    "session_is", "target_is", "transverse_moment", "turned_back",
)  # fmt: skip
_OF_SWEEPS = ("fixture_motion", "slip", "sweep_fraction", "sweep_progress", "wrench")
_OF_LOGS = (
    "axis_torque", "dry_state", "inclination_torque", "joint_acceleration", "joint_speed", "link_inertia_regressor",
    "motor_speed", "own_motion", "own_speed", "torque_rate",
)  # fmt: skip
SIGNALS_NOT_READ: Mapping[Stage, tuple[str, ...]] = {
    "free_air": (*_OF_POSES, *_OF_SWEEPS),
    "clamped": (*_OF_POSES, *_OF_LOGS, "regressor", "tool_regressor"),
    "poses": (*_OF_SWEEPS, *_OF_LOGS),
}
"""Signals that the rows of a stage do not have."""
ABSENT = 1e-12  # SI: rounding of a deviation that vanishes
ROWS_DRAWN = 5  # rows at random
GIVEN: Mapping[str, tuple[str | int, ...]] = {
    "transmission": ("n", "n"), "linkage": ("n", "n"), "link_vectors": ("n", 3), "turning_axes": ("n", 3),
}  # fmt: skip
"""What effects may read of the nominal robot."""
JOINTS = (6, 7, 8, 10, 12)  # an effect may sit at a joint that smaller robots do not have


def check_own_effect(effect: Effect) -> None:
    """Refuse an effect that does not vanish at zero amplitudes, or that no output of a stage of its can show.

    Raises
    ------
    EffectError
        With the effect's name, what was expected, and what was found.
    """
    if all(p.shape for p in effect.parameters):
        raise EffectError(f"effect {effect.name}: expected a parameter that is an amplitude, found shapes only")
    for stage in effect.stages:
        if stage not in OUTPUTS_OF_STAGES:  # a stage that takes its effects over from another
            raise EffectError(
                f"effect {effect.name}: expected stages among {', '.join(OUTPUTS_OF_STAGES)}, found {stage}"
            )
        if not any(station in OUTPUTS_OF_STAGES[stage] for station in effect.acts):
            raise EffectError(
                f"effect {effect.name}: nothing that {stage} measures shows {_listed(effect.acts)}; expected it to act "
                f"at one of: {', '.join(OUTPUTS_OF_STAGES[stage])}"
            )
        unread = [name for name in effect.needs if name in SIGNALS_NOT_READ[stage]]
        if unread:
            raise EffectError(f"effect {effect.name}: the rows of {stage} have no {_listed(unread)}, which it reads")
    for joints in JOINTS:
        try:
            found = {station: _deviation(effect, station, joints) for station in effect.acts}
        except IndexError:  # it sits at a joint beyond
            continue
        _check_amplitudes(effect, found)
        return


def _check_amplitudes(effect: Effect, found: Mapping[str, tuple[Any, Any, Any, Any]]) -> None:
    moves = False
    for station, (value, amplitudes, shapes, row) in found.items():
        moves = moves or ca.depends_on(value, amplitudes)
        function = ca.Function("deviation", [amplitudes, shapes, row], [ca.densify(value)])
        rng = np.random.default_rng(0)
        starts = [p.grid[0] for p in effect.parameters if p.shape]
        for _ in range(ROWS_DRAWN):
            at_zero = function(np.zeros(amplitudes.shape[0]), starts, rng.normal(size=row.shape[0]))
            largest = float(np.abs(np.asarray(at_zero)).max(initial=0.0))
            if not largest <= ABSENT:
                raise EffectError(
                    f"effect {effect.name}: expected no deviation at {station} where its amplitudes are zero, because "
                    f"zero means absent; found {largest:.3g}"
                )
    if not moves:
        raise EffectError(f"effect {effect.name}: its deviation depends on none of its amplitudes")


def _deviation(effect: Effect, station: str, joints: int) -> tuple[Any, Any, Any, Any]:
    """The deviation at a station as an expression, and its amplitudes, shapes and signals as symbols.

    Raises
    ------
    IndexError
        It sits at a joint that a robot of so many has not.
    EffectError
        It reads what it does not declare, or cannot be evaluated.
    """
    layout = Layout(joints, targets=("T1", "T2"), sessions=("session1",), wrist=(), anchors=("A1",))
    amplitudes: list[Any] = []
    shapes: list[Any] = []
    columns = {}
    for p in effect.parameters:
        count = len(layout.places(effect, p))
        symbol = ca.SX.sym(p.name, 1 if p.shape else count)
        (shapes if p.shape else amplitudes).append(symbol)
        columns[p.name] = ca.repmat(symbol, count, 1) if p.shape else symbol
    signals: list[Any] = []
    read = {}
    for name in (*GIVEN, *effect.needs):
        known = signal(name)
        shape = _size(GIVEN[name] if known is None else known.shape, layout)
        symbol = ca.SX.sym(name, *shape)
        signals.append(ca.vec(symbol))
        read[name] = symbol
    zero = ca.SX(*_size(STATIONS[station][0], layout))
    try:
        value = ca.vec(zero + effect.acts[station](SimpleNamespace(**columns), SimpleNamespace(**read)))
    except IndexError:
        raise
    except AttributeError as error:
        raise EffectError(f"effect {effect.name} reads what it does not declare: {error}") from error
    except RuntimeError as error:  # casadi's for an index beyond the end, and for anything else
        if "ut of bounds" in str(error):
            raise IndexError(str(error)) from error
        raise EffectError(f"effect {effect.name}: its deviation at {station} cannot be evaluated: {error}") from error
    return value, ca.vertcat(*amplitudes), ca.vertcat(*shapes), ca.vertcat(*signals)


def _size(shape: tuple[str | int, ...], layout: Layout) -> tuple[int, int]:
    n = layout.joints
    counts = {"n": n, "2n": 2 * n, "3n": 3 * n, "4n": 4 * n, "6n": 6 * n, "m": len(layout.targets), "a": 1, "s": 1}
    sizes = [counts[k] if isinstance(k, str) else k for k in shape]
    return (sizes[0] if sizes else 1, sizes[1] if len(sizes) > 1 else 1)


def _listed(names: Any) -> str:
    return ", ".join(names)
