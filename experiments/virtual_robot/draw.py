"""Builds one individual robot from a nominal description: every uncertain number is drawn at random."""

from __future__ import annotations

import numpy as np

from experiments.virtual_robot.description import Array, RobotDescription
from experiments.virtual_robot.plant import (
    Attachments,
    Drive,
    Fixture,
    Friction,
    Geometry,
    Heat,
    Instrument,
    Masses,
    Plant,
    Structure,
)
from experiments.virtual_robot.rotations import rotation_matrix

GRAVITY = np.array([0.0, 0.0, -9.81])
TOOL_MASS = 12.0
TOOL_COM = np.array([0.0, 0.0, 0.08])
TARGETS = {"T1": (0.10, 0.0, 0.12), "T2": (-0.05, 0.0866, 0.12), "T3": (-0.05, -0.0866, 0.12)}
ARCSEC = np.pi / 180 / 3600
GEARING = 100.0  # between motor and joint, where a description has none and logs the motors as if at the joints
DISC_MARKS = 36  # of an encoder, round its disc: errors of spacing show at every ten degrees
RIPPLES = 6  # per revolution of a motor, at most


def nominal_geometry(robot: RobotDescription) -> Geometry:
    """Return the geometry that the description promises."""
    axes = np.array([np.asarray(j.axis, dtype=float) for j in robot.joints])
    return Geometry(
        kinds=tuple(j.kind for j in robot.joints),
        axes=axes / np.linalg.norm(axes, axis=1, keepdims=True),
        points=np.array([np.asarray(j.point, dtype=float) for j in robot.joints]),
        pitch=np.array([float(j.pitch or 0.0) for j in robot.joints]),
        zero=np.zeros(len(robot.joints)),
        flange=np.array(robot.flange, dtype=float),
        linkage=np.array(getattr(robot, "linkage", np.eye(len(robot.joints))), dtype=float),
        targets={name: np.array(p) for name, p in TARGETS.items()},
    )


def nominal_masses(robot: RobotDescription) -> Masses:
    """Return the masses that the description and the declared tool promise."""
    n = len(robot.joints)
    if len(robot.links) > n:
        raise ValueError(f"{robot.name}: {len(robot.links)} moving links for {n} joints; link i moves with joint i")
    link, com = np.zeros(n), np.array([np.asarray(j.point, dtype=float) for j in robot.joints])
    for i, body in enumerate(robot.links):
        link[i], com[i] = body.mass, body.com
    return Masses(GRAVITY, link, com, TOOL_MASS, TOOL_COM)


def rated_torques(robot: RobotDescription) -> Array:
    """Return rated torques at the joints, Nm, guessed from the place in the arm where none is given."""
    guess = np.geomspace(1500.0, 100.0, len(robot.joints))
    given = [j.rated_torque for j in robot.joints]
    return np.array([g if r is None else float(r) for r, g in zip(given, guess, strict=True)])


def draw_plant(robot: RobotDescription, rng: np.random.Generator) -> Plant:
    """Draw one individual of the robot.

    Parameters
    ----------
    robot
        The nominal robot.
    rng
        The stream of the plant; nothing else may draw from it.

    Returns
    -------
    Plant
        True parameters, SI.
    """
    n = len(robot.joints)
    geometry = _draw_geometry(nominal_geometry(robot), rng)
    masses = _draw_masses(nominal_masses(robot), rng)
    drive = _draw_drive(robot, rng)
    shaft = drive.rated * np.abs(np.diag(drive.nominal))  # rated torque at the motors
    geared = np.abs(np.diag(drive.nominal)) < 0.5
    speed = np.array([float(j.max_speed or 3.0) for j in robot.joints]) / np.abs(np.diag(drive.nominal))
    zeros = np.zeros(n)
    coulomb = shaft * rng.uniform(0.05, 0.09, n)
    wrist = np.arange(n) >= 3  # in-line wrists: cables, seals and long shafts rub on the arm's side
    friction = Friction(
        coulomb=coulomb,
        viscous=coulomb * rng.uniform(0.5, 1.2, n) / (0.5 * speed),
        presliding=rng.uniform(2e-3, 5e-3, n) / np.where(geared, 1.0, GEARING),
        creep=zeros,
        arm=np.where(wrist, drive.rated * rng.uniform(0.015, 0.035, n), 0.0),
        stribeck=zeros,
        stribeck_speed=0.03 / np.abs(np.diag(drive.nominal)),
        asymmetry=zeros,
        load=zeros,
        thermal=zeros,
        ripple=np.zeros((n, 2 * RIPPLES)),
        offset=zeros,
        gain=zeros,
        lag=0.0,
    )
    return Plant(
        geometry=geometry,
        masses=masses,
        drive=drive,
        friction=friction,
        attachments=Attachments(zeros, zeros, 0.0, min(1, n - 1), (0.25, 0.7), 0.4, 0.0),
        structure=Structure(zeros, zeros, zeros, 0.0, np.zeros(6)),
        heat=_draw_heat(n, rng),
        instrument=_draw_instrument(geometry, shaft, rng),
        fixture=Fixture(np.zeros(6), np.zeros(6), np.inf, 0.05, np.array([3e-6] * 3 + [1e-5] * 3)),
        outside={},
    )


def _draw_geometry(nominal: Geometry, rng: np.random.Generator) -> Geometry:
    n = len(nominal.zero)
    axes = nominal.axes + 3e-4 * rng.standard_normal((n, 3))
    revolute = np.array([k != "prismatic" for k in nominal.kinds])
    zero = np.where(revolute, 5e-4, 3e-4) * rng.standard_normal(n)
    error = np.eye(4)
    error[:3, :3] = rotation_matrix(3e-4 * rng.standard_normal((1, 3)))[0]
    error[:3, 3] = 3e-4 * rng.standard_normal(3)
    return Geometry(
        kinds=nominal.kinds,
        axes=axes / np.linalg.norm(axes, axis=1, keepdims=True),
        points=nominal.points + 3e-4 * rng.standard_normal((n, 3)),
        pitch=nominal.pitch,
        zero=zero,
        flange=nominal.flange @ error,
        linkage=nominal.linkage,
        targets={name: p + 3e-4 * rng.standard_normal(3) for name, p in nominal.targets.items()},
    )


def _draw_masses(nominal: Masses, rng: np.random.Generator) -> Masses:
    n = len(nominal.link)
    return Masses(
        gravity=nominal.gravity,
        link=nominal.link * (1 + 0.03 * rng.standard_normal(n)),
        com=nominal.com + 6e-3 * rng.standard_normal((n, 3)),
        tool=nominal.tool,
        tool_com=nominal.tool_com,
    )


def _draw_drive(robot: RobotDescription, rng: np.random.Generator) -> Drive:
    n = len(robot.joints)
    T = np.array(robot.transmission, dtype=float)
    ratio = np.abs(np.diag(T))
    rated = rated_torques(robot)
    # 4 mrad at rated torque is what the reference robot's main axes give.
    spring = rated / 4e-3 * ratio**2 if robot.motor_spring is None else np.array(robot.motor_spring, dtype=float)
    arcsec = np.where(np.arange(n) < 3, rng.uniform(5, 15, n), rng.uniform(15, 60, n))
    return Drive(
        nominal=T,
        transmission=T,
        spring=spring * rng.uniform(0.8, 1.6, n),
        coupling=np.zeros((n, n)),
        extra_compliance=np.zeros(n),
        hardening=np.zeros(n),
        soft=np.zeros(n),
        soft_torque=np.ones(n),
        rated=rated,
        gap=arcsec * ARCSEC,
        reversal=np.zeros(n),
        slip=np.zeros((n, 3)),
        slip_torque=np.ones((n, 3)),
        eccentricity=np.zeros((n, 4)),
        resolver=np.zeros((n, 4)),
        disc=np.zeros((n, DISC_MARKS)),
        disc_turn=np.zeros(n),
        disc_sense=np.ones(n),
        tooth=np.tile([0.0, 0.0, 1.0], (n, 1)),
        rotor=3e-4 * (rated * ratio / rated[0] / ratio[0]) ** 0.5 * rng.uniform(0.7, 1.3, n),
    )


def _draw_heat(n: int, rng: np.random.Generator) -> Heat:
    return Heat(
        motor_time=rng.uniform(1200, 2400, n),
        motor_rise=rng.uniform(11, 22, n),
        link_time=rng.uniform(4000, 8000, n),
        contact_time=rng.uniform(2500, 6000, n),
        start=rng.uniform(0.0, 1.5, (2, n)),
        ambient=float(rng.uniform(20.5, 23.5)),
        swing=float(rng.uniform(0.3, 1.0)),
        period=float(rng.uniform(5000, 12000)),
        phase=float(rng.uniform(0, 2 * np.pi)),
    )


def _draw_instrument(geometry: Geometry, shaft: Array, rng: np.random.Generator) -> Instrument:
    n = len(shaft)
    basis, upper = np.linalg.qr(rng.standard_normal((3, 3)))
    basis = basis * np.sign(np.diag(upper))
    if np.linalg.det(basis) < 0:
        basis[:, 2] *= -1
    reach = np.linalg.norm(geometry.flange[:3, 3] - geometry.points, axis=1) + 0.15
    return Instrument(
        rotation=basis,
        origin=rng.uniform(-4.0, 4.0, 3),
        sigma=float(np.round(rng.uniform(20e-6, 60e-6), 6)),
        scale=1.0,
        # Equal shares of 20 µm at the flange of a stretched arm: about 15 µm in usual poses.
        repeatability=20e-6 / np.sqrt(n) / reach * rng.uniform(0.7, 1.3, n),
        torque_sigma=shaft * rng.uniform(0.006, 0.012, n),
        temperature_sigma=0.02,
    )
