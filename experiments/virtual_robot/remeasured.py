"""Another session of the same robot: a new place of the instrument, a new mount of the tool, other temperatures."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from experiments.virtual_robot.description import RobotDescription
from experiments.virtual_robot.draw import draw_plant
from experiments.virtual_robot.plant import Plant

FIRST_VISIT = 1
OF_SESSIONS = 5  # the branch of a robot's seed that its later sessions come from; the first one has branches 0 to 4


@dataclass(frozen=True)
class Seeds:
    """The random streams of a session.

    Attributes
    ----------
    plant, hidden
        The robot's: the same in all sessions.
    program, noise, spoil
        The session's.
    place
        Of instrument, tool and air; None in the first session, where they were drawn with the robot.
    """

    plant: np.random.SeedSequence
    hidden: np.random.SeedSequence
    program: np.random.SeedSequence
    noise: np.random.SeedSequence
    spoil: np.random.SeedSequence
    place: np.random.SeedSequence | None


def seeds_of(seed: int, session: int) -> Seeds:
    """Return what a session, counted from 1, of the robot of a seed is drawn from."""
    if session < FIRST_VISIT:
        raise ValueError(f"session: expected {FIRST_VISIT} or more, found {session}")
    plant, program, noise, spoil, hidden = np.random.SeedSequence(seed).spawn(5)
    place = None
    if session > FIRST_VISIT:
        later = np.random.SeedSequence(seed, spawn_key=(OF_SESSIONS, session))
        place, program, noise, spoil = later.spawn(4)
    return Seeds(plant, hidden, program, noise, spoil, place)


def set_up_anew(robot: RobotDescription, plant: Plant, place: np.random.SeedSequence | None) -> Plant:
    """Return the same robot in another session; what is hidden in it stays as it is.

    Parameters
    ----------
    robot
        The nominal robot.
    plant
        The individual, in its first session.
    place
        What the session is drawn from; None leaves the first session.

    Returns
    -------
    Plant
        Different are the place of the instrument, the targets on the flange, the air's temperature and its course, and
        the robot's temperature at switch-on. The instrument itself (noise, scale) is the same.
    """
    if place is None:
        return plant
    other = draw_plant(robot, np.random.default_rng(place))
    air = {key: getattr(other.heat, key) for key in ("start", "ambient", "swing", "period", "phase")}
    return replace(
        plant,
        geometry=replace(plant.geometry, targets=other.geometry.targets),
        instrument=replace(plant.instrument, rotation=other.instrument.rotation, origin=other.instrument.origin),
        heat=replace(plant.heat, **air),
    )
