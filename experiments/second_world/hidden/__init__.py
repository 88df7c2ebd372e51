"""
The effects that a robot of this world may hide, by name.

Those with a family name are in the list of CAMPAIGN_FORMAT.md; the others lie outside any library.
"""

from experiments.second_world.hidden import of_joints, of_structure, of_torques, outside
from experiments.second_world.hidden.kinds import Active, HiddenEffect, Parameter, Setting

__all__ = ["HIDDEN", "Active", "HiddenEffect", "Parameter", "Setting"]

HIDDEN: dict[str, HiddenEffect] = {
    effect.name: effect for effect in (*of_joints.EFFECTS, *of_structure.EFFECTS, *of_torques.EFFECTS, *outside.EFFECTS)
}
