"""Orientations in every convention come back as the rotations that they were."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from foreign_files import ANGLES, CAMPAIGN, HEAD, JOINTS, PLACE, imported, refused
from scipy.spatial.transform import Rotation

from experiments.campaign import Campaign
from experiments.foreign.medians import medians
from experiments.tables import TableFile


def flange_rows(original: Campaign) -> tuple[pd.DataFrame, Rotation]:
    """The arm's poses with the orientation that the nominal flange has, and its positions."""
    from kinematics.poe import forward

    table = original.tables["poses"].drop_duplicates("pose").reset_index(drop=True)
    place = forward(original.robot.screws, original.robot.flange, table[ANGLES].to_numpy() @ original.robot.linkage.T)
    out = pd.DataFrame({"Point": table["pose"]})
    for i in range(6):
        out[f"A{i + 1}"] = np.rad2deg(table[ANGLES[i]])
    out[["X", "Y", "Z"]] = 1e3 * place[:, :3, 3]
    return out, Rotation.from_matrix(place[:, :3, :3])


def matrix_of(axes: str, angles: np.ndarray) -> np.ndarray:
    """Rotations (rows, 3, 3) of Euler angles written out: capitals turn about the turned axes, so multiply on."""
    turns = []
    for axis, angle in zip(axes, angles.T, strict=True):
        c, s, o, e = np.cos(angle), np.sin(angle), np.zeros_like(angle), np.ones_like(angle)
        rows = {"x": [[e, o, o], [o, c, -s], [o, s, c]], "y": [[c, o, s], [o, e, o], [-s, o, c]],
                "z": [[c, -s, o], [s, c, o], [o, o, e]]}[axis.lower()]  # fmt: skip
        turns.append(np.moveaxis(np.array(rows), 2, 0))
    a, b, c3 = turns
    return a @ b @ c3 if axes.isupper() else c3 @ b @ a


ROTATIONS: dict[str, tuple[str, Callable[[Rotation], np.ndarray]]] = {
    "kuka A B C": ('kind = "kuka"', lambda r: r.as_euler("ZYX", degrees=True)),
    "roll pitch yaw about fixed axes": ('kind = "euler"\naxes = "xyz"', lambda r: r.as_euler("xyz", degrees=True)),
    "ZYZ": ('kind = "euler"\naxes = "ZYZ"', lambda r: r.as_euler("ZYZ", degrees=True)),
    "scalar first": ('kind = "quaternion_wxyz"', lambda r: -r.as_quat()[:, [3, 0, 1, 2]]),
    "scalar last": ('kind = "quaternion_xyzw"', lambda r: r.as_quat()),
    "matrix": ('kind = "matrix"', lambda r: r.as_matrix().reshape(-1, 9)),
    "rotation vector": ('kind = "rotation_vector"\nangle = "rad"', lambda r: r.as_rotvec()),
    "the other way": ('kind = "matrix"\ninverse = true', lambda r: r.inv().as_matrix().reshape(-1, 9)),
}


@pytest.mark.parametrize("name", ROTATIONS)
def test_orientations(original: Campaign, tmp_path: Path, name: str) -> None:
    table, rotation = flange_rows(original)
    words, of = ROTATIONS[name]
    numbers = of(rotation)
    if 'axes = "' in words or "kuka" in words:  # what the convention means, written out
        axes = words.split('axes = "')[1][:3] if "axes" in words else "ZYX"
        np.testing.assert_allclose(matrix_of(axes, np.deg2rad(numbers)), rotation.as_matrix(), atol=1e-12)
    columns = [f"r{i}" for i in range(numbers.shape[1])]
    table[columns] = numbers
    (tmp_path / "poses.csv").write_text(table.to_csv(index=False))
    orientation = f"[orientation]\n{words}\nfrom = {columns}\n".replace("'", '"')
    columns_ = '[columns]\npose = {from = "Point"}\ntarget = {value = "flange"}\n' + JOINTS + PLACE
    found = imported(tmp_path, HEAD + columns_ + orientation + CAMPAIGN, tmp_path / "poses.csv").tables["poses"]
    back = Rotation.from_quat(found[["qx", "qy", "qz", "qw"]].to_numpy())
    assert (rotation.inv() * back).magnitude().max() < 1e-7


def test_samples_of_one_orientation_may_have_either_sign(original: Campaign, tmp_path: Path) -> None:
    table, rotation = flange_rows(original)
    rows = np.repeat(np.arange(len(table)), 4)
    noisy = rotation[rows] * Rotation.from_rotvec(1e-4 * np.random.default_rng(0).standard_normal((len(rows), 3)))
    sign = np.where(np.arange(len(rows)) % 2, -1.0, 1.0)
    samples = table.loc[rows].reset_index(drop=True)
    samples[["i", "j", "k", "r"]] = sign[:, None] * noisy.as_quat()
    (tmp_path / "poses.csv").write_text(samples.to_csv(index=False))
    mapping = 'repeats = "median"\n[columns]\npose = {from = "Point"}\ntarget = {value = "flange"}\n' + JOINTS + PLACE
    mapping += '[orientation]\nkind = "quaternion_xyzw"\nfrom = ["i", "j", "k", "r"]\n'
    found = imported(tmp_path, HEAD + mapping + CAMPAIGN, tmp_path / "poses.csv").tables["poses"]
    back = Rotation.from_quat(found[["qx", "qy", "qz", "qw"]].to_numpy())
    assert (rotation.inv() * back).magnitude().max() < 5e-4
    assert (found["samples"] == 4).all()


def test_samples_of_half_a_turn_lie_on_either_side_of_the_sign(tmp_path: Path) -> None:
    """About half a turn the scalar part is zero within the noise, so that its sign is either."""
    turn = Rotation.from_rotvec(np.pi * np.array([0.6, 0.0, 0.8]))
    samples = Rotation.from_rotvec(1e-4 * np.random.default_rng(1).standard_normal((6, 3))) * turn
    quaternion = samples.as_quat(canonical=True)[:, [3, 0, 1, 2]]
    assert np.ptp(quaternion[:, 1]) > 1.0  # of both signs
    frame = pd.DataFrame({"pose": 1, "visit": 1, "target": "flange", "time_s": np.arange(6.0), "q1_rad": 0.5},
                         index=range(6))  # fmt: skip
    frame[["x_m", "y_m", "z_m"]] = 0.0
    frame[["qw", "qx", "qy", "qz"]] = quaternion
    found = medians(frame, TableFile(tmp_path / "poses.csv"), 1)[0]
    back = Rotation.from_quat(found[["qx", "qy", "qz", "qw"]].to_numpy()[0])
    assert (turn.inv() * back).magnitude() < 3e-4


def test_what_is_no_rotation_is_refused(original: Campaign, tmp_path: Path) -> None:
    table, rotation = flange_rows(original)
    columns = [f"r{i}" for i in range(9)]
    table[columns] = rotation.as_matrix().reshape(-1, 9)
    table.loc[2, "r0"] += 0.1
    (tmp_path / "poses.csv").write_text(table.to_csv(index=False))
    mapping = '[columns]\npose = {from = "Point"}\ntarget = {value = "flange"}\n' + JOINTS + PLACE
    mapping += f'[orientation]\nkind = "matrix"\nfrom = {columns}\n'.replace("'", '"')
    words = refused(tmp_path, HEAD + mapping + CAMPAIGN, tmp_path / "poses.csv")
    assert "poses.csv, row 3 (line 4), column r0, r1" in words
    assert "expected a rotation matrix" in words
