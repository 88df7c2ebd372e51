"""What compiling takes and gives: a fit and its diagnosis with an empty cache, with a filled one, and uncompiled.

    python benchmarks/first_diagnosis.py [--runs 1] [--poses 200]

Each in a process of its own, on one thread: a robot's pose table and its torque log, each with a hidden effect. Time is
processor time with that of the compiler. The last two columns are ratios to the time without a compiler: where the
first of them is above 1, too much is compiled (clampid.chain.compiled).
"""

from __future__ import annotations

import argparse
import os
import resource
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path

from experiments.simulate import simulate

CASES = {
    "poses": ("gear_eccentricity", ("poses", "verification")),
    "free_air": ("stribeck_friction", ("free_air", "wrist")),
}
WORK = """
import sys
from clampid.diagnosis.diagnose import diagnose
from clampid.identification.identify import identify
from experiments.campaign import read_campaign
campaign = read_campaign(sys.argv[1])
diagnose(identify(campaign), campaign)
"""


def seconds(folder: Path, more: Mapping[str, str]) -> float:
    """Processor time of one fit and diagnosis, s, in an environment with some more variables."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    one = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    subprocess.run([sys.executable, "-c", WORK, str(folder)], check=True, env={**os.environ, **one, **more})
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("--runs", type=int, default=1)
    parser.add_argument("--poses", type=int, default=200)
    given = parser.parse_args()
    print(f"{'':10}{'empty cache':>12}{'filled':>8}{'uncompiled':>12}{'empty / un':>12}{'filled / un':>12}")
    for name, (hidden, tables) in CASES.items():
        for _ in range(given.runs):
            with tempfile.TemporaryDirectory() as folder:
                arm, cache = Path(folder) / "arm", {"XDG_CACHE_HOME": str(Path(folder) / "cache")}
                simulate(arm, hidden=[hidden], seed=1, poses=given.poses, tables=tables)
                empty, filled = seconds(arm, cache), seconds(arm, cache)
                none = seconds(arm, {**cache, "CLAMPID_COMPILER": "none"})
            print(
                f"{name:10}{empty:12.1f}{filled:8.1f}{none:12.1f}{empty / none:12.2f}{filled / none:12.2f}", flush=True
            )


if __name__ == "__main__":
    main()
