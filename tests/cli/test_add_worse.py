"""``add`` that makes the held-out error worse says so and writes nothing, unless it is told to go on."""

from __future__ import annotations

from pathlib import Path

from cli_runner import Clampid


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
