"""Meshes of obstacles: read here, checked, and given a convex hull, before any compiled library sees them.

Collision libraries end the whole process on a mesh without volume or with a vertex that is no number. STL and OBJ are
read by this module, COLLADA (.dae) by coal in a process of its own, which may fail alone.
"""

from __future__ import annotations

import io
import subprocess
import sys
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import coal  # type: ignore[import-untyped]
import numpy as np
import numpy.typing as npt
from scipy.spatial import ConvexHull, QhullError

__all__ = ["SHEET", "Mesh", "MeshError", "read_mesh"]

Array = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]

MAX_BYTES = 200_000_000  # of a file
MAX_TRIANGLES = 2_000_000
FARTHEST_VERTEX = 1000.0  # m from its own origin
FLAT = 1e-5  # m: a mesh thinner than this is a sheet
SHEET = 1e-3  # m, thickness that a sheet is given
NO_AREA = 1e-14  # m^2: a triangle of less is a line
DAE_SECONDS = 60.0
_DAE = (
    "import sys, numpy as np, coal; m = coal.MeshLoader().load(sys.argv[1], np.ones(3)); "
    "np.savez(sys.stdout.buffer, v=np.asarray(m.vertices()), "
    "t=np.array([list(m.tri_indices(i)) for i in range(m.num_tris)]))"
)


class MeshError(ValueError):
    """A file that is no mesh, or one that no distance can be computed to; the message says why."""


@dataclass(frozen=True, eq=False)
class Mesh:
    """Triangles in space, and the hull around them.

    Attributes
    ----------
    vertices, triangles
        ``(N, 3)`` m and ``(M, 3)`` indices.
    hull_vertices, hull_triangles
        The same of the convex hull.
    thickened
        Whether it was a flat sheet, and has been given a thickness.
    """

    vertices: Array
    triangles: Integers
    hull_vertices: Array
    hull_triangles: Integers
    thickened: bool

    def surface(self) -> Any:
        """Its triangles, for distances by coal."""
        model = coal.BVHModelOBBRSS()
        model.beginModel(len(self.triangles), len(self.vertices))
        model.addSubModel(_points(self.vertices), _corners(self.triangles))
        model.endModel()
        model.computeLocalAABB()
        return model

    def hull(self) -> Any:
        """Its convex hull, which has an inside, for coal."""
        return coal.Convex(_points(self.hull_vertices), _corners(self.hull_triangles))


def read_mesh(file: Path) -> Mesh:
    """Read and check a mesh: STL, OBJ or DAE, metres.

    Raises
    ------
    MeshError
        It is none, too large, has vertices that are no numbers or too far away, or no area.
    """
    try:
        status = file.stat()
        if not file.is_file():
            raise MeshError("expected a regular file")
        if status.st_size > MAX_BYTES:
            raise MeshError(f"expected at most {MAX_BYTES} bytes, found {status.st_size}")
        return _read(file, status.st_mtime_ns, status.st_size)
    except OSError as error:
        raise MeshError(f"cannot be read: {error.strerror or error}") from error


@lru_cache(maxsize=32)
def _read(file: Path, _changed: int, _size: int) -> Mesh:
    readers = {".stl": _stl, ".obj": _obj, ".dae": _dae}
    reader = readers.get(file.suffix.lower())
    if reader is None:
        raise MeshError(f"expected a file {', '.join(readers)}, found {file.suffix or file.name!r}")
    return _checked(*reader(file))


def _checked(vertices: Array, triangles: Integers) -> Mesh:
    if not len(triangles):
        raise MeshError("expected triangles, found none")
    if len(triangles) > MAX_TRIANGLES:
        raise MeshError(f"expected at most {MAX_TRIANGLES} triangles, found {len(triangles)}")
    if triangles.min() < 0 or triangles.max() >= len(vertices):
        raise MeshError("a triangle names a vertex that does not exist")
    used, triangles = np.unique(triangles, return_inverse=True)
    vertices, triangles = vertices[used], triangles.reshape(-1, 3)
    bad = ~np.isfinite(vertices).all(axis=1)
    if bad.any():
        raise MeshError(f"vertex {used[bad][0] + 1} is not three finite numbers")
    far = float(np.abs(vertices).max())
    if far > FARTHEST_VERTEX:
        raise MeshError(f"a vertex is {far:.3g} m away; expected metres, at most {FARTHEST_VERTEX:g}")
    corners = vertices[triangles]
    area = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    triangles = triangles[area > NO_AREA]
    if not len(triangles):
        raise MeshError("it has no area: all its triangles are lines or points")
    middle = vertices.mean(axis=0)
    normal = np.linalg.svd(vertices - middle, full_matrices=False)[2][2]
    flat = float(np.ptp((vertices - middle) @ normal)) < FLAT
    if flat:
        shift = 0.5 * SHEET * normal
        triangles = np.vstack([triangles, triangles[:, ::-1] + len(vertices)])
        vertices = np.vstack([vertices + shift, vertices - shift])
    try:
        hull = ConvexHull(vertices)
    except (QhullError, ValueError):
        try:
            hull = ConvexHull(vertices, qhull_options="QJ Pp")  # joggled by rounding: nearly flat, nearly equal points
        except (QhullError, ValueError):
            raise MeshError("no convex hull can be put around it") from None
    corner, faces = np.unique(hull.simplices, return_inverse=True)
    points, faces = vertices[corner], faces.reshape(-1, 3)
    return Mesh(vertices, triangles, points, _outward(points, faces, hull.equations[:, :3]), flat)


def _outward(points: Array, faces: Integers, normals: Array) -> Integers:
    """Turn each face so that its corners run counter-clockwise seen from outside."""
    a, b, c = (points[faces[:, k]] for k in range(3))
    inward = np.einsum("ij,ij->i", np.cross(b - a, c - a), normals) < 0
    return np.where(inward[:, None], faces[:, ::-1], faces)


def _stl(file: Path) -> tuple[Array, Integers]:
    data = file.read_bytes()
    count = int.from_bytes(data[80:84], "little") if len(data) >= 84 else -1
    if count >= 0 and len(data) == 84 + 50 * count:
        record = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("rest", "<u2")])
        corners = np.frombuffer(data, record, count, 84)["corners"].astype(float)
    else:
        if not data.lstrip()[:5].lower() == b"solid":
            raise MeshError("expected STL, binary or text, found something else")
        words = data.split()
        at = [k for k, word in enumerate(words) if word.lower() == b"vertex"]
        if not at or len(at) % 3 or at[-1] + 3 >= len(words):
            raise MeshError("expected three vertices to each facet")
        corners = _floats([words[k + i] for k in at for i in (1, 2, 3)]).reshape(-1, 3, 3)
    return _joined(corners.reshape(-1, 3))


def _joined(points: Array) -> tuple[Array, Integers]:
    """Equal corners as one vertex."""
    if not np.isfinite(points).all():
        return points, np.arange(len(points)).reshape(-1, 3)
    vertices, index = np.unique(points, axis=0, return_inverse=True)
    return vertices, index.reshape(-1, 3).astype(np.int64)


def _obj(file: Path) -> tuple[Array, Integers]:
    points: list[bytes] = []
    faces: list[tuple[int, int, int]] = []
    for number, line in enumerate(file.read_bytes().splitlines(), 1):
        words = line.split()
        if not words or words[0] not in (b"v", b"f"):
            continue
        if len(words) < 4:
            raise MeshError(f"line {number}: expected three numbers or more, found {len(words) - 1}")
        if words[0] == b"v":
            points += words[1:4]
            continue
        try:
            corners = [int(word.partition(b"/")[0]) for word in words[1:]]
        except ValueError:
            raise MeshError(f"line {number}: expected numbers of vertices") from None
        if 0 in corners:
            raise MeshError(f"line {number}: vertices are counted from 1")
        index = [c - 1 if c > 0 else len(points) // 3 + c for c in corners]
        faces += [(index[0], index[k], index[k + 1]) for k in range(1, len(index) - 1)]
        if len(faces) > MAX_TRIANGLES:
            raise MeshError(f"expected at most {MAX_TRIANGLES} triangles, found more")
    try:
        triangles = np.array(faces, dtype=np.int64).reshape(-1, 3)
    except OverflowError:
        raise MeshError("a triangle names a vertex that does not exist") from None
    return _floats(points).reshape(-1, 3), triangles


def _floats(words: list[bytes]) -> Array:
    try:
        return np.array([float(word) for word in words])
    except ValueError:
        raise MeshError("a coordinate of a vertex is no number") from None


def _dae(file: Path) -> tuple[Array, Integers]:
    """By coal, in a process of its own: what its reader does with a bad file cannot be caught in this one."""
    try:
        done = subprocess.run(
            [sys.executable, "-c", _DAE, str(file)], capture_output=True, check=False, timeout=DAE_SECONDS
        )
    except subprocess.TimeoutExpired:
        raise MeshError(f"it cannot be read within {DAE_SECONDS:g} s") from None
    if done.returncode != 0:
        raise MeshError("expected COLLADA with triangles, found something else")
    with np.load(io.BytesIO(done.stdout), allow_pickle=False) as found:
        return np.asarray(found["v"], dtype=float).reshape(-1, 3), np.asarray(found["t"], dtype=np.int64).reshape(-1, 3)


def _points(vertices: Array) -> Any:
    out = coal.StdVec_Vec3s()
    out.extend(list(vertices))
    return out


def _corners(triangles: Integers) -> Any:
    out = coal.StdVec_Triangle()
    out.extend([coal.Triangle(*map(int, row)) for row in triangles])
    return out
