"""Sessions of one robot diagnosed together: one effect of the robot, found in both; each with its own base."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from clampid.diagnosis.diagnose import diagnose
from clampid.identification.identify import identify
from clampid.loop.auto import auto
from clampid.models.model import Model, ModelError
from experiments.campaign import Campaign

Simulated = Callable[..., Campaign]

EFFECTS = ("geometry", "joint_compliance", "backlash", "gravity", "wrist_coupling_friction")
XYZ = ("x_m", "y_m", "z_m")


def moved(campaign: Campaign) -> Campaign:
    """The same poses seen by an instrument that stands elsewhere."""
    turn, shift = Rotation.from_rotvec([0.02, -0.01, 0.7]), np.array([0.4, -1.2, 0.1])
    table = campaign.tables["poses"].copy()
    table[list(XYZ)] = turn.apply(table[list(XYZ)].to_numpy(float, copy=True)) + shift
    return replace(campaign, tables={"poses": table}, name="evening", fingerprint="evening")


@pytest.fixture(scope="module")
def sessions(simulated: Simulated) -> tuple[Campaign, Campaign]:
    """Two halves of a campaign on a robot with an eccentric gear; between them the instrument was moved."""
    whole = simulated(seed=5, poses=200, tables=("poses",), hidden=("gear_eccentricity@joint1",))
    table = whole.tables["poses"]
    early = (table["pose"] < table["pose"].median()).to_numpy()
    halves = [
        replace(whole, tables={"poses": table[part].reset_index(drop=True)}, name=name, fingerprint=name)
        for part, name in ((early, "morning"), (~early, "evening"))
    ]
    return halves[0], moved(halves[1])


@pytest.fixture(scope="module")
def model(sessions: tuple[Campaign, Campaign]) -> Model:
    return identify(sessions, EFFECTS)


@pytest.mark.slow
def test_what_is_missing_is_reported_from_both_sessions(sessions: tuple[Campaign, Campaign], model: Model):
    found = diagnose(model, sessions).stages["poses"]
    assert found.verdict == "missing"
    assert (found.candidates[0]["name"], found.candidates[0]["where"]) == ("gear_eccentricity", ["joint1"])
    assert found.exported_shift
    # Twice the poses tell more than one session of them does.
    alone = diagnose(model, sessions[0]).stages["poses"]
    assert found.candidates[0]["explained"] > 1.3 * alone.candidates[0]["explained"]


@pytest.mark.slow
def test_auto_adds_it_to_a_model_of_both(sessions: tuple[Campaign, Campaign]):
    model, found = auto(sessions, EFFECTS)
    assert [t.label for t in found.stages["poses"].added] == ["gear_eccentricity@joint1"]
    assert len(model.sessions) == 2
    assert "gear_eccentricity" in {t.effect for t in model.stages["poses"].terms}
    assert diagnose(model, sessions).stages["poses"].verdict == "adequate"


def test_sessions_that_the_model_was_not_fitted_on_are_refused(sessions: tuple[Campaign, Campaign], model: Model):
    with pytest.raises(ModelError, match=r"in their order \(morning, evening\), found others"):
        diagnose(model, sessions[::-1])
