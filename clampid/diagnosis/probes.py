"""Probes: physics-free candidates, each joint's, frame's or motor's error against each recorded variable.

If a probe is significant and no effect is, the residual has structure that the catalogue does not explain. The probe
names its place and the variables on which it depends: one recorded variable, or two together.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations, combinations_with_replacement

import numpy as np

from clampid.evidence.candidates import Candidate
from clampid.evidence.columns import AnyColumns, Columns, Levers, Products, channel_starts, columns_from
from clampid.evidence.of_size import SIZES
from clampid.fitting.solve import Estimate
from clampid.search_policy import JOINT_ANGLE_PERIODIC
from clampid.stages import poses
from clampid.stages.further_columns import further_of
from clampid.stages.rows import Array, Rows
from clampid.stages.temperatures import shared_temperatures

__all__ = ["JOINT_ANGLE_PERIODIC", "probes"]

Covariate = tuple[str, tuple[str, ...], Array]  # what it is, the variables, (N, k)
HARMONICS = 3
OTHERS = 6  # of another joint's revolution, in a motor's torque: rollers, teeth and cables come several times a turn
SWINGS = 8  # turns of an instrument's readings over the campaign: air conditioning, doors
STEP_OF_TURNS = 0.25  # between the periods of single swings: at most a fiftieth of a swing is missed
RANGES = 6  # of a motor's speed
PERIODIC = 40  # harmonics of a joint's revolution: 32 or fewer leave much of a ragged curve
SURFACE = 2  # harmonics of each of two angles, on which the error of a joint or motor depends
ANGLE_SIZE = 3e-4  # rad, rms: the upper end of errors of joints' transmissions and encoders


def probes(estimate: Estimate) -> list[Candidate]:
    """All probes of the estimate's stage."""
    rows = estimate.problem.rows
    if rows.kind.points:
        return _pose_probes(estimate)
    if rows.kind.moving:
        of_one = _motor_probes(estimate, _log_covariates(rows, estimate.problem.loads(estimate.theta)))
        return [*of_one, *_motor_surfaces(estimate)]  # the simpler ones are preferred where they explain as much
    return _motor_probes(estimate, _sweep_covariates(rows)) if rows.kind.solved else []


def _probe(estimate: Estimate, place: str, what: str, variables: Sequence[str], columns: Array) -> Candidate | None:
    """A probe from its columns ``(N, m, k)``, SI per unit of covariate."""
    if not np.any(columns):
        return None
    rows = estimate.problem.rows
    white = estimate.noise.whiten(rows, np.zeros(columns.shape[:2]), columns, estimate.whitened.filters)
    kept = columns_from(white, list(range(columns.shape[2])))
    return Candidate(f"{what} at {place}", "probe", (), (), {}, kept, tuple(variables), (place,))


def _harmonics(angle: Array, orders: int) -> Array:
    return np.column_stack([f(k * angle) for k in range(1, orders + 1) for f in (np.sin, np.cos)])


def _scaled(x: Array) -> Array:
    """A covariate less its mean, over its spread; zeros if it does not vary."""
    spread = float(np.std(x))
    return (
        (x - np.mean(x)) / spread if spread > 1e-12 * (1 + float(np.max(np.abs(x), initial=0.0))) else np.zeros_like(x)
    )


def _pose_probes(estimate: Estimate) -> list[Candidate]:
    problem = estimate.problem
    rows, n = problem.rows, problem.rows.robot.n
    theta = estimate.theta[: len(problem.slots)]
    deviations = poses.evaluate(rows, problem.chain, theta)
    _, sensitivity = poses.by_station(rows, deviations)
    width = rows.measured.shape[1]
    offsets = problem.chain.offsets
    s = rows.signals
    elapsed = _scaled(s["elapsed"])
    slow = np.column_stack([elapsed, elapsed**2])
    found: list[Candidate | None] = []
    levers = Levers.of(estimate, sensitivity[:, :, offsets["joint_angle"]])
    around = _surroundings(rows)
    others, pairs = _by_other_joints(rows), _by_two_angles(rows)
    for j in range(n):
        q, load = s["q"][:, j], _scaled(s["gravity_torque"][:, j])
        own: list[Covariate] = [
            (f"harmonics of q{j + 1}", (f"q{j + 1}",), _harmonics(q, HARMONICS)),
            (f"load of joint {j + 1}", (f"tau{j + 1}",), np.column_stack([load, load**2, load**3])),
            ("time", ("time",), slow),
        ]
        for kind in ("link", "motor"):
            warm = _scaled(s[f"{kind}_temperature"][:, j])
            own.append((f"temp_{kind}{j + 1}", (f"temp_{kind}{j + 1}",), warm[:, None]))
        of_others = [c for c in pairs if f"q{j + 1}" not in c[1]]
        own += [c for c in (*others, *of_others, *around) if c[1] != (f"q{j + 1}",)]
        found += _at(levers, [j], f"joint{j + 1}", own)
    frames = [("base", offsets["base_twist"].start), ("flange", offsets["link_twist"].stop - 6)]
    frames += [(f"link{i + 1}", offsets["link_twist"].start + 6 * i) for i in range(n - 1)]
    for name, start in frames:
        link = int(name[4:]) if name.startswith("link") else (1 if name == "base" else n)
        warm = _scaled(s["link_temperature"][:, link - 1])
        own = [("time", ("time",), elapsed[:, None]), (f"temp_link{link}", (f"temp_link{link}",), warm[:, None])]
        own += around
        if name in ("base", "flange"):  # what turns or stops there moves them, and no joint's error can say it
            own += others
        found += _at(Levers.of(estimate, sensitivity[:, :, start : start + 6]), range(6), name, own)
    place = np.column_stack([_scaled(column) for column in rows.signals["position"].T])
    readings: list[Covariate] = [(f"position along {a}", (a,), place[:, k, None]) for k, a in enumerate("xyz")]
    for (i, a), (k, b) in combinations_with_replacement(enumerate("xyz"), 2):
        both = tuple(dict.fromkeys((a, b)))
        readings.append((f"position along {a} times {b}", both, (place[:, i] * place[:, k])[:, None]))
    turn = 2.0 * np.pi * (s["elapsed"] / max(float(np.ptp(s["elapsed"])), 1e-300))  # one over the campaign
    readings += [*around, ("swing in time", ("time",), np.column_stack([slow, _harmonics(turn, SWINGS)]))]
    for turns in np.arange(1.0, SWINGS + STEP_OF_TURNS, STEP_OF_TURNS):
        readings.append((f"swing of {turns:g} turns in time", ("time",), _harmonics(turns * turn, 1)))
    for what, variables, reading in readings:
        count = reading.shape[1]
        columns = np.zeros((len(rows), width, 3 * count))
        for axis in range(3):
            columns[:, axis, axis * count : (axis + 1) * count] = reading
        found.append(_probe(estimate, "instrument", what, variables, columns))
    waves = _surface_waves(rows)
    for j in range(n):  # after all simpler ones, which are preferred where they explain as much
        found += _at(levers, [j], f"joint{j + 1}", _surfaces(waves, j), ANGLE_SIZE)
    found.append(_periodic(rows, levers))
    return [p for p in found if p is not None]


def _surroundings(rows: Rows) -> list[Covariate]:
    """What belongs to no single link or motor: temperatures of surroundings and other sensors, and further columns."""
    recorded = shared_temperatures(rows) | further_of(rows)
    found = {name: _scaled(values)[:, None] for name, values in recorded.items()}
    return [(name, (name,), x) for name, x in found.items() if np.any(x)]


def _by_other_joints(rows: Rows) -> list[Covariate]:
    """Covariates of the error of any joint or of base and flange: an angle, a direction, or one times the other."""
    s, n = rows.signals, rows.robot.n
    waves = [_harmonics(s["q"][:, k], 1) for k in range(n)]
    out: list[Covariate] = []
    for k in range(n):
        q, d, name = s["q"][:, k], s["direction"][:, k], k + 1
        out.append((f"harmonics of q{name}", (f"q{name}",), waves[k]))
        out.append((f"dir{name}", (f"dir{name}",), d[:, None]))
        out.append((f"q{name} times dir{name}", (f"q{name}", f"dir{name}"), (_scaled(q) * d)[:, None]))
        for i in range(n):
            other = f"q{i + 1}"
            if i != k:
                out.append((f"{other} times dir{name}", (other, f"dir{name}"), waves[i] * d[:, None]))
    return out


def _by_two_angles(rows: Rows) -> list[Covariate]:
    """Products of the angles of two joints, for the error of any third one."""
    q = rows.signals["q"]
    waves = [_harmonics(q[:, k], 2) for k in range(rows.robot.n)]
    return [
        (f"products of q{i + 1} and q{k + 1}", (f"q{i + 1}", f"q{k + 1}"), _products(waves[i], waves[k]))
        for i, k in combinations(range(rows.robot.n), 2)
    ]


def _surface_waves(rows: Rows) -> list[Array]:
    """One and the harmonics of each joint's angle ``(N, 1 + 2 SURFACE)``, of whose products surfaces consist."""
    q = rows.signals["q"]
    return [np.column_stack([np.ones(len(rows)), _harmonics(q[:, k], SURFACE)]) for k in range(rows.robot.n)]


def _surfaces(waves: Sequence[Array], joint: int) -> list[Covariate]:
    """Any smooth function of a joint's own angle and another one, for each other joint."""
    pairs = [sorted((joint, other)) for other in range(len(waves)) if other != joint]
    names = [(f"q{i + 1}", f"q{k + 1}") for i, k in pairs]
    return [
        (f"surface over {a} and {b}", (a, b), _products(waves[i], waves[k])[:, 1:])
        for (a, b), (i, k) in zip(names, pairs, strict=True)
    ]


def _products(a: Array, b: Array) -> Array:
    """All products ``(N, f g)`` of functions ``(N, f)`` and ``(N, g)``."""
    return (a[:, :, None] * b[:, None, :]).reshape(len(a), -1)


def _at(
    levers: Levers, chosen: Sequence[int], place: str, covariates: Sequence[Covariate], size: float | None = None
) -> list[Candidate]:
    """Pose probes: levers at a place, times each covariate.

    With a ``size``, SI, each has a prior: its functions have one standard deviation, their sum this rms over the rows.
    """
    if not np.any(levers.values[:, list(chosen)]):
        return []
    own = [c for c in covariates if np.any(c[2])]
    return [_of(place, c, Products(levers, tuple(chosen), (c[2],) * len(chosen)).whitened, size) for c in own]


def _of(place: str, covariate: Covariate, columns: AnyColumns, size: float | None = None) -> Candidate:
    """A probe of a covariate at a place, from its whitened columns; ``size`` as of :func:`_at`."""
    what, variables, x = covariate
    probe = Candidate(f"{what} at {place}", "probe", (), (), {}, columns, variables, (place,))
    if size is None:
        return probe
    each = size / float(np.sqrt(np.mean(np.sum(x**2, axis=1))))
    return replace(probe, prior=np.full(columns.width, each), sizes=SIZES)


def _periodic(rows: Rows, levers: Levers) -> Candidate | None:
    """Errors of all joint angles, each any periodic function of its own joint, down to a few degrees' width.

    All joints at once: a single joint would absorb the others' errors, and none would be significant. The many columns
    are regularised by a prior: their total rms is at most :data:`ANGLE_SIZE`, spread evenly.

    Parameters
    ----------
    levers
        Of the joints' angles.
    """
    seen = np.any(levers.values, axis=0)
    if not seen.any():
        return None
    joints = np.flatnonzero(seen)
    functions = tuple(_harmonics(rows.signals["q"][:, j], PERIODIC) for j in joints)
    columns = Products(levers, tuple(joints.tolist()), functions).whitened
    return Candidate(
        name=JOINT_ANGLE_PERIODIC,
        family="probe",
        terms=(),
        slots=(),
        shapes={},
        columns=columns,
        depends_on=tuple(f"q{j + 1}" for j in joints),
        places=tuple(f"joint{j + 1}" for j in joints),
        prior=np.full(columns.width, ANGLE_SIZE / PERIODIC**0.5),
        sizes=SIZES,
    )


def _log_covariates(rows: Rows, borne: Array) -> list[list[Covariate]]:
    """Covariates of each motor's torque. ``borne`` ``(N, n)``, Nm: what the joints bear, as effects see it."""
    s, n = rows.signals, rows.robot.n
    T = np.asarray(rows.robot.transmission)
    elapsed, around = _scaled(s["elapsed"]), _surroundings(rows)
    loads = borne @ T.T
    sizes = np.abs(loads) / np.maximum(loads.std(axis=0), 1e-300)
    waves = [_harmonics(s["q"][:, k], 1) for k in range(n)]
    pairs: list[Covariate] = []
    for k, i in combinations(range(n), 2):
        pairs.append((f"products of q{k + 1} and q{i + 1}", (f"q{k + 1}", f"q{i + 1}"), _products(waves[k], waves[i])))
    out = []
    for i in range(n):
        w, sign, q = _scaled(s["motor_speed"][:, i]), s["motor_motion"][:, i], s["q"][:, i]
        load = _scaled(loads[:, i])
        warm = _scaled(s["motor_temperature"][:, i])
        speed = np.abs(w)
        name = i + 1
        own: list[Covariate] = [
            (
                f"speed of motor {name}",
                (f"qd{name}",),
                np.column_stack([sign * np.exp(-4 * speed), sign * np.exp(-speed), w * speed]),
            ),
            (f"narrow ranges of the speed of motor {name}", (f"qd{name}",), _of_speed(w, sign)),
            (f"harmonics of q{name}", (f"q{name}",), _harmonics(q, HARMONICS)),
            (
                f"motion times load of motor {name}",
                (f"qd{name}", f"tau{name}"),
                np.column_stack([sign * load, sign * np.abs(load)]),
            ),
            (f"load of motor {name}", (f"tau{name}",), np.column_stack([load**2, load**3])),
            (f"motion times q{name}", (f"qd{name}", f"q{name}"), np.column_stack([sign * np.sin(q), sign * np.cos(q)])),
            (
                f"motion times temperature of motor {name}",
                (f"qd{name}", f"temp_motor{name}"),
                np.column_stack([sign * warm, w * warm]),
            ),
            (f"temperature of motor {name}", (f"temp_motor{name}",), warm[:, None]),
            ("constant", (f"tau{name}",), np.ones((len(rows), 1))),
            ("time", ("time",), np.column_stack([elapsed, elapsed**2])),
            ("motion times time", (f"qd{name}", "time"), np.column_stack([sign * elapsed, w * elapsed])),
        ]
        for what, variables, x in around:
            own.append((what, variables, x))
            own.append((f"motion times {what}", (f"qd{name}", *variables), np.column_stack([sign, w]) * x))
        for k in range(n):
            if k != i:
                other = k + 1
                own.append((f"harmonics of q{other}", (f"q{other}",), _harmonics(s["q"][:, k], OTHERS)))
                own.append((f"motion of motor {other}", (f"qd{other}",), s["motor_motion"][:, k, None]))
                moved = np.column_stack([sign, w])
                own.append((f"motion times q{other}", (f"qd{name}", f"q{other}"), sign[:, None] * waves[k]))
                dragged = s["motor_motion"][:, k, None] * waves[k]
                own.append((f"motion of motor {other} times q{other}", (f"qd{other}", f"q{other}"), dragged))
                pressed = moved * sizes[:, k, None]
                own.append((f"motion times load of motor {other}", (f"qd{name}", f"tau{other}"), pressed))
        own += pairs
        out.append(own)
    return out


def _of_speed(w: Array, sign: Array) -> Array:
    """Waves over the range of a motor's speeds, with and without its sign ``(N, 12)``: the shape of a resonance."""
    share = np.pi * np.abs(w) / max(float(np.max(np.abs(w), initial=0.0)), 1e-300)
    waves = np.column_stack([np.cos(k * share) for k in range(1, RANGES + 1)])
    return np.column_stack([sign[:, None] * waves, waves])


def _sweep_covariates(rows: Rows) -> list[list[Covariate]]:
    s, n = rows.signals, rows.robot.n
    T = np.asarray(rows.robot.transmission)
    elapsed, fraction = _scaled(s["elapsed"]), s["sweep_fraction"] - 0.5
    around = _surroundings(rows)
    out = []
    for i in range(n):
        sign, mine = s["motor_motion"][:, i], (rows.sweep.driven == i).astype(float)
        stiff = 1.0 / max(float(T[i, i] ** 2), 1e-12)
        name = i + 1
        own: list[Covariate] = [
            ("constant", (f"tau{name}",), mine[:, None]),
            ("time", ("time",), np.column_stack([elapsed, fraction])),
            (
                f"motion times time of motor {name}",
                (f"motor{name}", "time"),
                np.column_stack([sign * elapsed, sign * fraction]),
            ),
            (f"temp_motor{name}", (f"temp_motor{name}",), _scaled(s["motor_temperature"][:, i])[:, None]),
            *around,
        ]
        for k in range(n):
            x = rows.sweep.wound[:, k] * np.sqrt(stiff)
            x = x / max(float(np.std(x)), 1e-12)
            driven = rows.sweep.driven == k
            moved = np.where(driven, x, 0.0)
            powers = (moved**2, moved**3) if k == i else (moved, moved**2, moved**3)
            own.append((f"motor angle {k + 1}", (f"motor{k + 1}",), np.column_stack(powers)))
            turned = s["motor_motion"][:, k]
            if k != i:
                own.append((f"motion of motor {k + 1}", (f"motor{k + 1}",), turned[:, None]))
            else:
                own.append(
                    (
                        f"motion times angle of motor {k + 1}",
                        (f"motor{k + 1}",),
                        np.column_stack([turned * moved, turned * np.abs(moved)]),
                    )
                )
        out.append(own)
    return out


def _motor_probes(estimate: Estimate, covariates: Sequence[Sequence[Covariate]]) -> list[Candidate]:
    """Probes of torques: each motor's error against its covariates."""
    white = estimate.whitened
    return [
        probe
        for start, stop in channel_starts(white)
        for probe in _of_motor(estimate, start, stop, covariates[int(white.channel[start])])
    ]


def _motor_surfaces(estimate: Estimate) -> list[Candidate]:
    """Probes of torques: each motor's error as a surface over two angles, of the size of its noise."""
    white, waves, found = estimate.whitened, _surface_waves(estimate.problem.rows), list[Candidate]()
    for start, stop in channel_starts(white):
        i = int(white.channel[start])
        noise = float(np.median(estimate.noise.sigma[:, i]))
        found += _of_motor(estimate, start, stop, _surfaces(waves, i), noise)
    return found


def _of_motor(
    estimate: Estimate, start: int, stop: int, covariates: Sequence[Covariate], size: float | None = None
) -> list[Candidate]:
    """Probes of the motor whose whitened numbers are those from ``start`` to ``stop``; ``size`` as of :func:`_at`."""
    i = int(estimate.whitened.channel[start])
    stacked = np.concatenate([x for _, _, x in covariates], axis=1)
    block = estimate.noise.whiten_channel(estimate.problem.rows, i, stacked)
    if stop - start != len(block):
        raise ValueError(f"motor {i + 1}: expected {stop - start} whitened rows, found {len(block)}")
    found, first = [], 0
    for covariate in covariates:
        width = covariate[2].shape[1]
        part = np.ascontiguousarray(block[:, first : first + width])
        first += width
        if np.any(part):
            found.append(_of(f"motor{i + 1}", covariate, Columns(((start, part),), width), size))
    return found
