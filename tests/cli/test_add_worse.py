"""``add`` that makes the held-out error worse says so and writes nothing, unless it is told to go on."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from cli_runner import Clampid

from clampid.loop.change import Change, paired_change


@pytest.mark.slow
def test_an_effect_that_makes_the_held_out_error_worse_is_not_added_silently(
    poses_only: Path, tmp_path: Path, clampid: Clampid
) -> None:
    model = tmp_path / "model.json"
    effects = "geometry,backlash,joint_compliance,gear_eccentricity@joint2"
    assert clampid("identify", poses_only, "-o", model, "--effects", effects, "-q").code == 0
    asked = ("add", "poses=link_bending,poses=bearing_tilt", model, poses_only)
    ran = clampid(*asked, "-o", tmp_path / "worse.json", "-q")
    assert ran.code == 2
    assert "poses: the held-out error would rise from " in ran.complaint
    assert ran.complaint.endswith("nothing is written. To go on all the same: --accept-worse")
    assert list(tmp_path.iterdir()) == [model]
    ran = clampid(*asked, "-o", tmp_path / "worse.json", "--accept-worse", "--json", "-", "-q")
    assert ran.code == 0
    assert (tmp_path / "worse.json").is_file()
    part = ran.json["stages"]["poses"]
    assert part["heldout_rms_after"] > part["heldout_rms_before"]


@pytest.mark.slow
def test_a_change_within_its_standard_error_is_said_and_written(
    poses_only: Path, tmp_path: Path, clampid: Clampid
) -> None:
    """An effect that these poses hardly show changes the held-out error by nothing that could be told from chance."""
    model, out = tmp_path / "model.json", tmp_path / "same.json"
    effects = "geometry,backlash,joint_compliance,gear_eccentricity@joint2"
    assert clampid("identify", poses_only, "-o", model, "--effects", effects, "-q").code == 0
    asked = ("add", "poses=gear_eccentricity@joint6", model, poses_only)
    ran = clampid(*asked, "-o", out, "-q", "--json", tmp_path / "a.json")
    part = json.loads((tmp_path / "a.json").read_text())["stages"]["poses"]
    assert abs(part["heldout_rise"]) < part["heldout_rise_std"]
    assert ran.code == 0
    assert out.is_file()
    assert "No change of the held-out error within its standard error." in ran.out


def test_the_standard_error_of_a_change_is_that_of_many_campaigns() -> None:
    """Rows of a pose go together: single rows as units would give a standard error that is far too small."""
    rng = np.random.default_rng(0)
    poses, targets = 60, 3
    unit = np.repeat(np.arange(poses), targets)

    def campaign() -> Change:
        shared = np.repeat(rng.normal(1.0, 0.2, poses), targets)
        before = shared**2 + rng.normal(0, 0.05, len(unit)) ** 2
        after = (shared + np.repeat(rng.normal(0.0, 0.1, poses), targets)) ** 2
        return paired_change(before, after, unit)

    found = [campaign() for _ in range(400)]
    truth = np.std([c.rise for c in found])
    assert np.mean([c.std for c in found]) == pytest.approx(truth, rel=0.1)
    single = paired_change(np.ones(180), np.ones(180) + rng.normal(0, 0.1, 180), np.arange(180))
    assert single.units == 180


def test_a_rise_counts_beyond_one_standard_error_and_any_where_there_is_none() -> None:
    assert Change(1.0, 1.02, 0.03, 40).worse is False
    assert Change(1.0, 1.02, 0.03, 40).within_noise is True
    assert Change(1.0, 1.04, 0.03, 40).worse is True
    assert Change(1.0, 0.9, 0.03, 40).worse is False
    one = paired_change(np.ones(5), 1.01 * np.ones(5), np.zeros(5, dtype=int))
    assert one.std == np.inf
    assert one.worse is True
    assert one.within_noise is False
    assert Change(1.0, 1.0 + 1e-9, np.inf, 1).worse is False  # rounding
