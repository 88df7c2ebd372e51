"""Meshes of obstacles: what is no body is refused or thickened, and never ends the process."""

from __future__ import annotations

import struct
import subprocess
import sys
from pathlib import Path

import coal
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from kinematics.collision.bodies import distance_of
from kinematics.collision.mesh import SHEET, MeshError, read_mesh

TETRAHEDRON = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]])[[[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]]]
PLATE = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0.0]])[[[0, 1, 2], [0, 2, 3]]]
CLAMPID = Path(sys.executable).parent / "clampid"


def binary_stl(path: Path, corners: np.ndarray) -> Path:
    record = b"".join(struct.pack("<12fH", 0, 0, 0, *t.ravel(), 0) for t in corners)
    path.write_bytes(b"\0" * 80 + struct.pack("<I", len(corners)) + record)
    return path


def text_stl(path: Path, corners: np.ndarray) -> Path:
    facets = [
        "facet normal 0 0 0\nouter loop\n"
        + "".join(f"vertex {v[0]} {v[1]} {v[2]}\n" for v in t)
        + "endloop\nendfacet\n"
        for t in corners
    ]
    path.write_text(f"solid thing\n{''.join(facets)}endsolid thing\n")
    return path


def obj(path: Path, corners: np.ndarray) -> Path:
    lines = [f"v {v[0]} {v[1]} {v[2]}\n" for v in corners.reshape(-1, 3)]
    lines += [f"f {3 * k + 1}/1 {3 * k + 2}//2 {3 * k + 3}\n" for k in range(len(corners))]
    path.write_text("".join(lines))
    return path


WRITERS = {".stl": binary_stl, ".text.stl": text_stl, ".obj": obj}


@pytest.mark.parametrize("kind", WRITERS)
def test_each_format_gives_the_same_body(kind: str, tmp_path: Path) -> None:
    mesh = read_mesh(WRITERS[kind](tmp_path / f"tetra{kind}", TETRAHEDRON))
    assert not mesh.thickened
    np.testing.assert_allclose(np.sort(mesh.vertices[mesh.triangles].ravel()), np.sort(TETRAHEDRON.ravel()))
    a, b, c = (mesh.hull_vertices[mesh.hull_triangles[:, k]] for k in range(3))
    assert np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6 == pytest.approx(1 / 6)  # outward faces: volume > 0


@pytest.mark.parametrize("kind", WRITERS)
def test_a_plate_is_thickened(kind: str, tmp_path: Path) -> None:
    mesh = read_mesh(WRITERS[kind](tmp_path / f"plate{kind}", PLATE))
    assert mesh.thickened
    assert np.ptp(mesh.vertices, axis=0) == pytest.approx([1, 1, SHEET])
    mesh.surface(), mesh.hull()


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1e38])
@pytest.mark.parametrize("kind", WRITERS)
def test_a_vertex_that_is_no_place_is_refused(kind: str, value: float, tmp_path: Path) -> None:
    corners = TETRAHEDRON.copy()
    corners[1, 2, 1] = value
    with pytest.raises(MeshError, match=r"finite numbers|m away"):
        read_mesh(WRITERS[kind](tmp_path / f"odd{kind}", corners))


@pytest.mark.parametrize(
    ("name", "content", "says"),
    [
        ("a.obj", b"", "expected triangles, found none"),
        ("a.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 4\n", "does not exist"),
        ("a.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 -9\n", "does not exist"),
        ("a.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 99999999999999999999\n", "does not exist"),
        ("a.obj", b"v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n", "no area"),
        ("a.obj", b"v 0 0\n", "line 1: expected three numbers"),
        ("a.obj", b"v 0 0 zero\nv 1 0 0\nv 0 1 0\nf 1 2 3", "no number"),
        ("a.stl", b"solid x vertex 1 2", "three vertices"),
        ("a.stl", b"\0" * 100, "expected STL"),
        ("a.step", b"", "expected a file .stl, .obj, .dae"),
        ("a.dae", b"<COLLADA", "expected COLLADA"),
    ],
)
def test_what_is_no_mesh_is_refused(name: str, content: bytes, says: str, tmp_path: Path) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(MeshError, match=says):
        read_mesh(tmp_path / name)


@settings(deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=200)
@given(data=st.data())
def test_any_triangles_are_a_body_or_refused(data: st.DataObject, tmp_path: Path) -> None:
    number = st.sampled_from([0.0, 1.0, -1.0, 1e-9, 1e-5, 1e-30, 0.5, 999.0, 1e38, np.nan, np.inf])
    count = data.draw(st.integers(0, 5))
    corners = np.array(data.draw(st.lists(number, min_size=9 * count, max_size=9 * count))).reshape(-1, 3, 3)
    kind = data.draw(st.sampled_from(list(WRITERS)))
    try:
        mesh = read_mesh(WRITERS[kind](tmp_path / f"any{kind}", corners))
    except MeshError:
        return
    at = np.eye(3), np.array([3.0, 0.0, 0.0])
    capsule = coal.Capsule(0.1, 1.0), coal.Transform3s(*at)
    for body in (mesh.surface(), mesh.hull()):
        assert np.isfinite(distance_of(body, coal.Transform3s.Identity(), *capsule))


@pytest.mark.slow
@pytest.mark.parametrize("content", ["plate", "nan"])
def test_ik_survives_it(content: str, model_file: Path, cell_file: Path, tmp_path: Path) -> None:
    corners = PLATE + np.array([0.0, 0.0, 5.0])
    if content == "nan":
        corners[0, 0, 0] = np.nan
    text_stl(tmp_path / "stage.stl", corners)
    cell = tmp_path / "cell.toml"
    cell.write_text(cell_file.read_text() + '\n[[obstacle]]\nname = "stage"\nshape = "mesh"\nfile = "stage.stl"\n')
    place = ("--gamma", "0.3", "--delta", "0.2", "--r", "0.8", "--cell", cell)
    done = subprocess.run(
        [str(CLAMPID), "ik", str(model_file), *map(str, place)], capture_output=True, text=True, check=False, timeout=60
    )
    if content == "nan":
        assert (done.returncode, "stage.stl is no mesh: vertex" in done.stderr) == (2, True), done.stderr
    else:
        assert done.returncode == 0, done.stderr
        said = " ".join((done.stdout + done.stderr).split())
        assert "obstacle stage: the mesh is flat; it counts as a sheet 1 mm thick" in said
