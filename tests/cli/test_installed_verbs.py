"""A broken package of somebody else's is reported where it is asked for, in one line; every other verb works."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
POINTS = """[clampid.verbs]
fine = third_ok:fine
identify = third_ok:fine
missing = third_missing:verb
raises = third_raises:verb
exits = third_exits:verb
lacks = third_ok:nothing
number = third_ok:number
malformed = !!!
[clampid.robot_links]
broken = third_missing:connect
number = third_ok:number
"""
MODULES = {
    "third_raises": 'raise ValueError("two\\nlines")\n',
    "third_exits": "import sys\nsys.exit(3)\n",
    "third_ok": ('number = 3\ndef fine(n: int = 1):\n    """Works."""\n    print("fine", n)\n'),
}


@pytest.fixture(scope="module")
def third(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where a package is installed whose verbs and links are broken in every way."""
    folder = tmp_path_factory.mktemp("third")
    info = folder / "third-1.2.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: third\nVersion: 1.2\n")
    (info / "entry_points.txt").write_text(POINTS)
    for name, text in MODULES.items():
        (folder / f"{name}.py").write_text(text)
    return folder


def call(third: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    paths = os.pathsep.join([str(ROOT), str(third), os.environ.get("PYTHONPATH", "")])
    return subprocess.run(
        [sys.executable, "-m", "clampid", *arguments],
        capture_output=True, text=True, timeout=60, check=False, env={**os.environ, "PYTHONPATH": paths},
    )  # fmt: skip


@pytest.mark.parametrize(
    ("verb", "says"),
    [
        ("missing", "ModuleNotFoundError: No module named 'third_missing'"),
        ("raises", "ValueError: two lines"),
        ("exits", "SystemExit: 3"),
        ("lacks", "AttributeError"),
        ("number", "TypeError"),
        ("malformed", "AttributeError"),
    ],
)
def test_a_broken_verb_says_so_where_it_is_called(verb: str, says: str, third: Path) -> None:
    ran = call(third, verb, "file.json", "--output", "x", "-q")
    assert ran.returncode == 1
    assert ran.stderr.startswith(f"clampid: the verb {verb} of the package third 1.2 cannot be loaded: {says}")
    assert len(ran.stderr.splitlines()) == 1
    assert not ran.stdout


@pytest.mark.slow
def test_all_other_verbs_work_beside_it(third: Path) -> None:
    assert call(third, "fine", "--n", "2").stdout == "fine 2\n"
    assert call(third, "effects", "backlash").returncode == 0
    listed = call(third, "--help")
    assert listed.returncode == 0
    assert "Cannot be loaded (package third 1.2)." in listed.stdout
    assert "CAMPAIGN…" in call(third, "identify", "--help").stdout  # our own, not the one of the same name


@pytest.mark.parametrize(("scheme", "says"), [("broken", "ModuleNotFoundError"), ("number", "expected a function")])
def test_a_broken_link_says_so_where_it_is_asked_for(scheme: str, says: str, third: Path, tmp_path: Path) -> None:
    (tmp_path / "m.json").write_text("{}")
    ran = call(third, "serve", str(tmp_path / "m.json"), "--listen", "127.0.0.1:0", "--link", f"{scheme}://a:1")
    assert ran.returncode == 2
    assert f"link {scheme} of the package third 1.2" in ran.stderr
    assert says in ran.stderr
    assert len(ran.stderr.splitlines()) == 1
