"""pyFAI's geometry, held against pyFAI itself."""

from __future__ import annotations

import warnings
from dataclasses import replace

import numpy as np
import pytest

from offline_ik.cell.coordinates import CONVENTIONS, detector_pose
from offline_ik.cell.pyfai import pyfai_geometry

with warnings.catch_warnings():
    warnings.simplefilter("ignore")  # of pyFAI's own imports
    pyfai_module = pytest.importorskip("pyFAI.geometry", reason="pyFAI is not installed (pip install pyfai)")
    detectors = pytest.importorskip("pyFAI.detectors", reason="pyFAI is not installed")

PIXEL = 55e-6


@pytest.mark.parametrize("name", sorted(CONVENTIONS))
@pytest.mark.parametrize("where", [(0.3, 0.2, 0.0), (0.5, 0.35, 0.4), (-1.2, 0.7, -2.0), (0.0, 0.0, 0.0)])
def test_pyfai_puts_every_pixel_where_the_pose_does(name: str, where: tuple[float, float, float]) -> None:
    convention = replace(CONVENTIONS[name], beam=(0.6, 0.8, 0.0), sample=(0.3, 0.2, 0.1))
    pose = detector_pose(convention, where[0], where[1], 0.9, where[2])
    g = pyfai_geometry(convention, pose)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        theirs = pyfai_module.Geometry(**g.to_json(), detector=detectors.Detector(PIXEL, PIXEL, max_shape=(516, 1556)))
        d1, d2 = np.array([0.0, 0.01, -0.02]), np.array([0.0, 0.03, 0.01])
        x3, x1, x2 = theirs.calc_pos_zyx(d1=d1 / PIXEL - 0.5, d2=d2 / PIXEL - 0.5)
        two_theta = theirs.tth(d1 / PIXEL - 0.5, d2 / PIXEL - 0.5)
    points = pose[:3, :3] @ np.array([-d1, d2, 0 * d1]) + pose[:3, 3:]
    v = points - np.array(convention.sample)[:, None]
    axes = np.column_stack([convention.lab[:, 1], -convention.lab[:, 0], convention.lab[:, 2]])
    assert np.allclose([x1, x2, x3], axes.T @ v, atol=1e-12)
    assert np.allclose(np.cos(two_theta), np.array(convention.beam) @ v / np.linalg.norm(v, axis=0), atol=1e-9)


def test_the_direction_at_rot3_zero_is_the_published_one() -> None:
    g, d = 0.5, 0.35
    direction = -detector_pose(CONVENTIONS["nanomax"], g, d, 1.0)[:3, 2]
    h = np.sin(g) * np.cos(d)
    rot1, rot2 = np.arcsin(h), -np.arctan2(np.sin(d), np.cos(g) * np.cos(d))
    theirs = pyfai_module.Geometry(dist=1.0, rot1=rot1, rot2=rot2).rotation_matrix()[:, 2]
    lab = CONVENTIONS["nanomax"].lab
    axes = np.column_stack([lab[:, 1], -lab[:, 0], lab[:, 2]])
    assert np.allclose(axes @ theirs, direction, atol=1e-12)
