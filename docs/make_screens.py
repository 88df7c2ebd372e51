"""Record the screens of docs/reference/screens.md: python docs/make_screens.py [FOLDER WITH ur10_series_d].

Without the folder the recordings of the real robot stay as they are.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
from pathlib import Path

PAGE = Path(__file__).parent / "reference" / "screens.md"
SIMULATED = (
    "clampid check arm",
    "clampid identify arm -o model.json",
    "clampid compare model.json arm",
    "clampid diagnose model.json arm",
    "clampid add poses=gear_eccentricity@joint2 model.json arm -o mended.json",
    "clampid history mended.json",
    "clampid auto arm -o auto.json",
    "clampid ik model.json --gamma 0.3 --delta 0.2 --r 0.8",
    "clampid robots kuka_kr20_r1810",
    "clampid robots staubli_tx40",
    "clampid effects",
    "clampid effects gear_eccentricity",
    "clampid export dh model.json -o dh.csv",
    "clampid plan iso9283 --cube 1.0,0,0.8,0.4 -o iso.toml",
    "clampid plan line --from 1.0,-0.3,0.6 --to 1.0,0.3,0.6 -o line.toml",
    "clampid run line.toml -o measured --dry-run",
)
SERVED = "clampid serve model.json"
REAL = (
    "clampid check ur10_series_d",
    "clampid identify ur10_series_d -o ur10.json",
    "clampid compare ur10.json ur10_series_d",
    "clampid diagnose ur10.json ur10_series_d",
    "clampid auto ur10_series_d -o ur10_auto.json",
    "clampid ik ur10.json --gamma 0.3 --delta 0.2 --r 0.8",
)
MAKE = (
    "clampid simulate -o arm --poses 100 --tables free_air,wrist,poses,verification --hide gear_eccentricity@joint2 -q"
)
INTRODUCTION = f"""# What the verbs print

Every verb ends in one screen: at most 24 lines of 80 columns. The last lines are the next command. `--verbose` prints
the tables, too; `--json FILE` writes everything for programs. Colours appear on a terminal only, and not with
`NO_COLOR`. These recordings are made by `docs/make_screens.py`, and the tests run them again.

## A simulated campaign

<!-- first: {MAKE} -->
"""
BETWEEN = """
## A real robot

A Universal Robots UR10, measured by a laser tracker at 632 poses. See
[What a real robot was missing](../explanation/real-robot.md).

"""
UNTIL_INTERRUPTED = "\n<!-- not run: runs until interrupted -->\n"
NOT_RUN = "<!-- not run: the campaign is not in the repository -->\n"


def recorded(command: str, folder: str) -> str:
    """A console block with the command and what it prints."""
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    env = {**os.environ, "PATH": path, "COLUMNS": "80"}
    done = subprocess.run(["bash", "-c", command], cwd=folder, env=env, capture_output=True, text=True, check=True)
    return f"```console\n$ {command}\n{done.stdout}```\n"


def served(command: str, folder: str) -> str:
    """The same of a server, which says what it is when it listens; progress is left out."""
    words = [str(Path(sys.executable).parent / "clampid"), *command.split()[1:]]
    env = {**os.environ, "COLUMNS": "80", "PYTHONUNBUFFERED": "1"}
    said: list[str] = []
    with subprocess.Popen(words, cwd=folder, env=env, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True) as p:
        assert p.stdout is not None
        for line in p.stdout:
            said += [] if line.startswith("compiling") else [line]
            if line.startswith("listening"):
                p.send_signal(signal.SIGINT)
    return f"```console\n$ {command}\n{''.join(said)}```\n"


def main() -> None:
    """Write the page."""
    old = PAGE.read_text(encoding="utf-8") if PAGE.exists() else BETWEEN
    real = old.partition(BETWEEN)[2]
    with tempfile.TemporaryDirectory() as folder:
        subprocess.run(
            ["bash", "-c", f"export PATH={Path(sys.executable).parent}:$PATH; {MAKE}"], cwd=folder, check=True
        )
        simulated = "\n".join(recorded(command, folder) for command in SIMULATED)
        simulated += UNTIL_INTERRUPTED + served(SERVED, folder)
    if len(sys.argv) > 1:
        with tempfile.TemporaryDirectory() as folder:
            os.symlink(Path(sys.argv[1]).resolve() / "ur10_series_d", Path(folder) / "ur10_series_d")
            real = "\n".join(NOT_RUN + recorded(command, folder) for command in REAL)
    PAGE.write_text(INTRODUCTION + simulated + BETWEEN + real, encoding="utf-8")


if __name__ == "__main__":
    main()
