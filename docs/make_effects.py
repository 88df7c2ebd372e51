"""Write docs/reference/effects.md from the catalogue, and draw images/effects.png: ``python docs/make_effects.py``.

Words, equations, parameters and stages are the catalogue's. What an effect looks like in the residual, and what it is
confused with, stands here, family by family; a test holds that none is left out.
"""

from __future__ import annotations

import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import casadi
import numpy as np

from clampid.catalogue import catalogue
from clampid.stages.stage_kind import kinds
from clampid.verbs.effects import in_words

DOCS = Path(__file__).parent
ORDER = sorted(kinds(), key=lambda kind: not kind.points)
PAGE = DOCS / "reference" / "effects.md"
PICTURE = DOCS / "images" / "effects.png"

GROUPS: dict[str, tuple[str, ...]] = {
    "Geometry and links": ("geometry", "link_bending", "bearing_tilt", "base_tilt", "thermal_expansion"),
    "Joints and gears": ("gear_eccentricity", "coupling_ratio_error", "backlash", "joint_compliance",
                         "nonlinear_stiffness", "cross_coupled_stiffness", "hysteresis"),
    "Weight and loads": ("gravity", "base_inclination", "axis_misalignment", "payload", "gravity_compensator",
                         "dress_pack", "inertia"),
    "Friction": ("coulomb_friction", "viscous_friction", "stribeck_friction", "asymmetric_friction",
                 "load_dependent_friction", "temperature_dependent_friction", "wrist_coupling_friction"),
    "Motors and their signals": ("torque_ripple", "torque_offset", "torque_gain", "time_lag"),
    "Instrument and clamp": ("instrument_scale", "fixture_compliance"),
}  # fmt: skip

SIGNATURE: dict[str, tuple[str, str]] = {
    "geometry": (
        "Position errors that depend on the posture only, smooth over the workspace.",
        "An error of the flange frame is absorbed by the target positions, and one of joint 1's zero by the base.",
    ),
    "link_bending": (
        "Errors that grow with the moment on the link; largest with the arm stretched out level.",
        "Bearing tilt of a neighbouring joint; of link 1, base tilt. No pose separates the latter.",
    ),
    "bearing_tilt": (
        "A rotation across the joint's axis that follows the moment across it.",
        "Link bending of the same part; at joint 1, base tilt. An inclinometer on the base plate decides.",
    ),
    "base_tilt": (
        "A rotation of all points about the foot that follows the arm's moment, or the time since the start.",
        "Bearing tilt of joint 1 and bending of link 1. An inclinometer on the base plate decides.",
    ),
    "base_inclination": (
        "Torques that go with the sine and cosine of joint 1's angle, and of the joints that bear the weight.",
        "A dress pack or a gravity compensator at joint 1, where no other joint's torque is recorded.",
    ),
    "axis_misalignment": (
        "Torques of joints that bear weight, as a smooth function of the angles of the joint and its neighbours.",
        "A gravity compensator or dress pack of joint 2. Links of other weight, where few postures were visited.",
    ),
    "thermal_expansion": (
        "Points move outwards along a link as its temperature rises, or as the robot warms up.",
        "A settling base, where no link has a temperature sensor; the instrument's scale, where all links warm alike.",
    ),
    "gear_eccentricity": (
        "An error of one joint's angle that repeats with each turn of the joint, or of its motor.",
        "A gravity compensator, in poses alone: both are harmonics of the angle. Torques in free air decide.",
    ),
    "coupling_ratio_error": (
        "An error of one joint's angle that is proportional to another joint's angle, or to its own.",
        "Geometry, where the joint moves little. Use its whole range.",
    ),
    "backlash": (
        "Two values of the joint's angle at one posture: which one depends on the load, or on the approach direction.",
        "A spring that is soft near zero; arm-side friction that stays in the springs. Approach poses from both sides.",
    ),
    "joint_compliance": (
        "An error of the joint's angle that is proportional to its torque.",
        "The masses of the links: only the product shows in poses. Torques, or several known tools, separate them.",
    ),
    "nonlinear_stiffness": (
        "An error of the joint's angle that follows a curve over its torque.",
        "Backlash, for a drive that is soft near zero.",
    ),
    "cross_coupled_stiffness": (
        "A joint gives way to the torque of its neighbour.",
        "A yielding clamp; nonlinear stiffness.",
    ),
    "hysteresis": (
        "A loop of the torsion over the load, as wide after each reversal. In poses an error by the last motion that "
        "is smaller after a short way.",
        "Backlash and dry friction. Sweeps of several amplitudes, or ways of several lengths, separate them.",
    ),
    "gravity": (
        "Torques, or deflections, that follow the posture like a weight.",
        "The springs, in poses alone. Masses are identified in combinations only (base parameters).",
    ),
    "payload": (
        "The same as of a weight, at the flange.",
        "The mass of the last link. Measure with a second, known tool.",
    ),
    "gravity_compensator": (
        "A torque at one joint that is a smooth curve of its angle, whatever the rest of the arm does.",
        "Gear eccentricity, in poses alone; a dress pack or a torque offset, where the joint moves little.",
    ),
    "dress_pack": (
        "A torque that is proportional to the angle of a wrist joint.",
        "A torque offset (its constant part), and a gravity compensator at the same joint.",
    ),
    "inertia": (
        "Torques that are proportional to the acceleration: of the motor, or of several joints.",
        "A time lag of the log. On one axis the inertia of the rotor and that of the link are one number.",
    ),
    "coulomb_friction": (
        "A step of the torque where the speed changes its sign.",
        "Arm-side friction of a coupled wrist. Swings with the joint at rest separate them (`plan wrist`).",
    ),
    "viscous_friction": (
        "A torque that grows with the speed.",
        "Coulomb friction, in a log of one speed.",
    ),
    "stribeck_friction": (
        "More friction at slow speed than at medium speed.",
        "Coulomb friction, in a log without slow motion.",
    ),
    "asymmetric_friction": (
        "A step of another height in one direction.",
        "A torque offset together with Coulomb friction: on one axis the same.",
    ),
    "load_dependent_friction": (
        "A step whose height follows the weight on the joint.",
        "Coulomb friction, where the load changes little.",
    ),
    "temperature_dependent_friction": (
        "Friction that falls during the log, or with the motor's temperature.",
        "An offset that follows the temperature; nothing, in a log of one temperature.",
    ),
    "wrist_coupling_friction": (
        "A step at several motors at once where one wrist joint turns round.",
        "Coulomb friction of the motors, where each motor turns only with its own joint.",
    ),
    "torque_ripple": (
        "A torque that repeats with each turn of the motor.",
        "Noise, where the log is sampled too slowly for the motor's speed.",
    ),
    "torque_offset": (
        "A constant error of one motor's torque, or one that follows a temperature.",
        "Asymmetric friction; the constant part of a dress pack; at an upright axis, a base that is not level.",
    ),
    "torque_gain": (
        "An error of one motor's torque that is proportional to what the arm asks of it.",
        "The masses, where no other motor bears the same links. One gain of all motors is a gain of all masses.",
    ),
    "time_lag": (
        "An error that is proportional to the rate of the torque.",
        "Inertia and viscous friction.",
    ),
    "instrument_scale": (
        "Errors that are proportional to the distance from the instrument, or to a coordinate of it.",
        "The lengths of the arm and free target positions. A certified distance (`[[distance]]`) decides.",
    ),
    "fixture_compliance": (
        "All springs look too soft at once, or the torques jump once.",
        "The springs themselves; cross-coupled stiffness. A sensor on the block decides.",
    ),
}
"""Family → signature in the residual, what it is confused with and what separates the two."""


def _curve(name: str, signal: str, x: np.ndarray, values: dict[str, float], **others: Any) -> np.ndarray:
    """The deviation of an effect of the catalogue along one signal, by its own function."""
    effect = catalogue()[name]
    deviation = next(iter(effect.acts.values()))
    p = SimpleNamespace(**{q.name: casadi.DM(values.get(q.name, q.start)) for q in effect.parameters})
    given = {signal: casadi.DM(x), **{key: casadi.DM(value) for key, value in others.items()}}
    return np.asarray(deviation(p, SimpleNamespace(**given)), dtype=float).ravel()


def picture() -> None:
    """Draw six signatures, each by the equation of its effect."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    turn = np.linspace(-np.pi, np.pi, 400)
    speed = np.linspace(-1.0, 1.0, 801)
    load = np.linspace(-400.0, 400.0, 401)
    curve = catalogue()["joint_angle_curve"]
    rng = np.random.default_rng(1)
    many = {q.name: float(rng.normal()) / 7.0 for q in curve.parameters if not q.shape}
    eye = np.eye(len(load))  # the law of one joint at many loads: joints that nothing couples
    dry = _curve("coulomb_friction", "motor_motion", np.sign(speed), {"Fc": 0.3})
    slow = {"motor_motion": np.sign(speed)}
    stribeck = _curve("stribeck_friction", "motor_speed", speed, {"Fs": 0.2, "ws": 0.1}, **slow)
    viscous = _curve("viscous_friction", "motor_speed", speed, {"Fv": 0.3})
    spring = _curve("joint_compliance", "torque", load, {"c": 1e-6}, transmission=eye)
    soft = _curve("soft_near_zero", "torque", load, {"a": 1.5e-6, "s": 60.0}, transmission=eye)
    angle, torque = ("joint angle, degrees", "angle error, µrad"), ("motor speed, rad/s", "motor torque, Nm")
    by_load = ("joint torque, Nm", "angle error, µrad")
    panels = [
        ("gear eccentricity", angle, np.degrees(turn),
         1e6 * _curve("gear_eccentricity", "q", turn, {"a1": 1e-4, "b2": 5e-5})),
        ("joint angle curve", angle, np.degrees(turn),
         1e6 * _curve("joint_angle_curve", "q", turn, {**many, "rms": 1e-4})),
        ("local angle error", angle, np.degrees(turn),
         1e6 * _curve("local_angle_error", "q", turn, {"height": 2e-4, "middle": 0.6, "width": 0.5})),
        ("joint compliance", by_load, load, 1e6 * spring),
        ("with softness near zero", by_load, load, 1e6 * (spring + soft)),
        ("backlash, by the load", by_load, load, 1e6 * _curve("backlash", "flank", np.sign(load), {"gap": 2e-4})),
        ("Coulomb friction", torque, speed, dry),
        ("with Stribeck friction", torque, speed, dry + stribeck),
        ("with viscous friction", torque, speed, dry + viscous),
    ]  # fmt: skip
    figure, every = plt.subplots(3, 3, figsize=(9, 6.6), layout="constrained")
    for axes, (title, (x_name, y_name), x, y) in zip(every.flat, panels, strict=True):
        axes.plot(x, y, color="#0072b2", linewidth=1.8)
        axes.axhline(0.0, color="#bbbbbb", linewidth=0.8, zorder=0)
        axes.set_title(title, fontsize=10, loc="left")
        axes.set_xlabel(x_name, fontsize=8)
        axes.set_ylabel(y_name, fontsize=8)
        axes.tick_params(labelsize=7)
        axes.margins(x=0.02, y=0.15)
        axes.spines[["top", "right"]].set_visible(False)
    figure.savefig(PICTURE, dpi=130, metadata={"Software": None})
    plt.close(figure)


def page() -> str:
    """The page, from the catalogue."""
    effects = sorted(catalogue().values(), key=lambda effect: effect.name)
    lines = [
        "# Which effects there are",
        "",
        "<!-- Written by docs/make_effects.py from the catalogue; do not edit. -->",
        "",
        f"The catalogue has {len(effects)} effects in {len({e.family for e in effects})} families. An effect is a "
        "physical cause of an error, with a few numbers that are fitted. `clampid effects NAME` prints one in full. "
        "For each family the page says how it shows in the residual, and what it is confused with.",
        "",
        "![What effects look like: nine curves of error over angle, load or speed](../images/effects.png)",
        "",
        "*Signatures of nine effects, by their equations. Made by `docs/make_effects.py`.*",
    ]
    for title, families in GROUPS.items():
        lines += ["", f"## {title}"]
        for family in families:
            shows, confused = SIGNATURE[family]
            lines += ["", f"### {family.replace('_', ' ').capitalize()}", ""]
            lines += [f"* **In the residual**: {shows}", f"* **Confused with**: {confused}", ""]
            lines += ["| effect | what it is | equation | seen in |", "|---|---|---|---|"]
            for effect in effects:
                if effect.family == family:
                    seen = ", ".join(kind.name.replace("_", " ") for kind in ORDER if kind.has(effect))
                    words = in_words(effect).replace("|", "\\|")
                    equation = effect.equation.replace("|", "\\|")
                    lines.append(f"| `{effect.name}` | {words} | {equation} | {seen} |")
    lines += [
        "",
        "*Seen in*: poses are measured points, free air are torques of a moving arm, clamped are torques with "
        "the flange clamped. Symbols are those of the [glossary](../glossary.md) and of "
        "[the campaign folder](campaign.md).",
        "",
    ]
    return "\n".join(lines)


def main() -> None:
    """Write the page; with ``--picture`` draw the picture, too."""
    if "--picture" in sys.argv:
        picture()
    PAGE.write_text(page(), encoding="utf-8")


if __name__ == "__main__":
    main()
