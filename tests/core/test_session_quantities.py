"""Two sessions of one robot, each with a tool and an instrument of its own: what differs between them is found."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest

from clampid.catalogue import catalogue
from clampid.comparison.compare import compare
from clampid.effect import Stage
from clampid.evidence.candidates import terms_not_active
from clampid.identification.identify import identify
from clampid.models.model import Model, load_model, save_model
from clampid.models.session_differences import session_differences
from clampid.stages.fit_problem import fit_problem
from clampid.stages.rows import Rows
from experiments.campaign import Campaign, read_campaign
from experiments.simulate import simulate
from experiments.virtual_robot.plant import Plant

FIXED = ("geometry", "joint_compliance", "backlash", "gravity", "wrist_coupling_friction")
MASSES, SCALES = (1.5, -2.0), (4e-5, -8e-5)


def measured(folder: Path, mass: float, scale: float, half: int) -> Campaign:
    """Half of the poses of one robot whose tool is heavier than declared, seen by an instrument with a scale error."""

    def alter(plant: Plant) -> Plant:
        tool = plant.masses.tool + mass
        instrument = replace(plant.instrument, scale=plant.instrument.scale + scale)
        return replace(plant, masses=replace(plant.masses, tool=tool), instrument=instrument)

    path = simulate(folder, seed=7, poses=120, tables=("poses",), alter=alter)
    whole = read_campaign(path)
    table = whole.tables["poses"]
    part = table[table["pose"] % 2 == half].reset_index(drop=True)
    return replace(whole, tables={"poses": part}, name=f"half{half}", fingerprint=f"half{half}")


@pytest.fixture(scope="module")
def sessions(tmp_path_factory: pytest.TempPathFactory) -> tuple[Campaign, Campaign]:
    folder = tmp_path_factory.mktemp("sessions")
    one, two = (measured(folder / f"arm{k}", MASSES[k], SCALES[k], k) for k in range(2))
    return one, two


@pytest.fixture(scope="module")
def model(sessions: tuple[Campaign, Campaign]) -> Model:
    return identify(sessions, {"poses": [*FIXED, "session_payload", "session_scale"]})


def test_tools_and_scales_differ_as_they_do(model: Model):
    found = {d.parameter: d for d in session_differences(model.stages["poses"], catalogue())}
    mass, scale = found["session_payload.m"], found["session_scale.s"]
    assert (mass.session, mass.less, mass.unit) == ("session2", "session1", "kg")
    assert mass.value == pytest.approx(MASSES[1] - MASSES[0], abs=3 * mass.std)
    assert mass.std < 0.25 * abs(MASSES[1] - MASSES[0])
    assert scale.value == pytest.approx(SCALES[1] - SCALES[0], abs=3 * scale.std)
    assert scale.std < 0.25 * abs(SCALES[1] - SCALES[0])


def test_each_session_has_its_own_by_name(model: Model):
    labels = {slot.label for slot in model.stages["poses"].slots}
    for s in (1, 2):
        assert {f"session_payload.mz@session{s}", f"session_scale.s@session{s}"} <= labels


def test_one_for_both_leaves_what_differs(sessions: tuple[Campaign, Campaign], model: Model):
    common = identify(sessions, {"poses": [*FIXED, "payload", "instrument_scale"]})
    assert model.ledger[-1].rms < 0.9 * common.ledger[-1].rms
    assert session_differences(common.stages["poses"], catalogue()) == ()


@pytest.mark.slow
def test_the_file_keeps_them_and_one_session_has_its_own(
    sessions: tuple[Campaign, Campaign], model: Model, tmp_path: Path
):
    save_model(model, tmp_path / "m.json")
    back = load_model(tmp_path / "m.json")
    found = [session_differences(m.stages["poses"], catalogue()) for m in (model, back)]
    assert found[0] == found[1]
    errors = [compare(back, campaign).tables["poses"]["rms"] for campaign in sessions]
    assert max(errors) < 1.3 * model.ledger[-1].rms


def test_diagnosis_does_not_look_for_them(few_rows: dict[Stage, Rows]):
    effects = catalogue()
    trial = fit_problem(few_rows["poses"], effects, ())
    looked_for = {term.effect for term in terms_not_active(SimpleNamespace(slots=(), problem=trial), effects)}  # type: ignore[arg-type]
    assert {"payload", "instrument_scale"} <= looked_for
    assert not {"session_payload", "session_scale"} & looked_for
