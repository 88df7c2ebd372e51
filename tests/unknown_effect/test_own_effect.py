"""An effect of a user's own that a fit could not use is refused when it is loaded, with the reason."""

from __future__ import annotations

from pathlib import Path

import pytest

from clampid.catalogue import catalogue, with_user_effects
from clampid.effect import EffectError
from clampid.own_effect import OUTPUTS_OF_STAGES, check_own_effect
from clampid.stages.stage_kind import kinds

FILE = """
from clampid.effect import Effect, Parameter

def deviation(p, x):
    return {formula}

EFFECT = Effect(
    name="mine", family="mine", acts={{"{station}": deviation}}, parameters=(Parameter("c", "rad", 1e-4, per="joint"),),
    needs=({needs}), stages=("{stage}",), equation="x = c", source=("own measurements",), at="joint1",
)
"""


def load(folder: Path, formula: str, station: str = "joint_angle", stage: str = "poses", needs: str = '"q",') -> None:
    path = folder / "mine.py"
    path.write_text(FILE.format(formula=formula, station=station, stage=stage, needs=needs))
    with_user_effects(path)


@pytest.mark.parametrize("formula", ["p.c * x.q", "p.c * x.q**2 + 0.0"])
def test_what_vanishes_at_zero_is_loaded(tmp_path: Path, formula: str):
    load(tmp_path, formula)


@pytest.mark.parametrize("formula", ["p.c + 0.1", "0.1 * x.q", "(1 + p.c) * x.q", "p.c / p.c"])
def test_zero_must_mean_absent(tmp_path: Path, formula: str):
    """The first was fitted as a success that moved the base by 5.7 degrees."""
    with pytest.raises(EffectError, match=r"mine\.py: effect mine: expected no deviation at joint_angle where"):
        load(tmp_path, formula)


@pytest.mark.parametrize(
    ("station", "stage"), [("motor_torque", "poses"), ("measurement", "clamped"), ("link_twist", "free_air")]
)
def test_what_no_output_of_the_stage_shows_is_refused(tmp_path: Path, station: str, stage: str):
    """It silently did nothing."""
    with pytest.raises(EffectError, match=f"nothing that {stage} measures shows {station}; expected it to act at"):
        load(tmp_path, "p.c * x.q", station, stage)


def test_signals_that_the_stage_does_not_record_are_refused(tmp_path: Path):
    with pytest.raises(EffectError, match="the rows of poses have no motor_speed, which it reads"):
        load(tmp_path, "p.c * x.motor_speed", needs='"motor_speed",')


def test_what_depends_on_no_amplitude_is_refused(tmp_path: Path):
    with pytest.raises(EffectError, match="depends on none of its amplitudes"):
        load(tmp_path, "0 * p.c")


def test_the_catalogue_itself_passes():
    for effect in catalogue().values():
        check_own_effect(effect)
    for stage, outputs in ((kind.name, kind.outputs) for kind in kinds() if not kind.effects_of):
        assert set(outputs) <= set(OUTPUTS_OF_STAGES[stage])
