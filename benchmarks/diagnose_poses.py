"""The time of a whole diagnosis of a pose table of 750 rows, an eccentric gear hidden in it.

python benchmarks/diagnose_poses.py [--runs 3]
"""

from __future__ import annotations

import argparse
import os
import tempfile
from pathlib import Path
from time import perf_counter

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np

from clampid.diagnose import diagnose
from clampid.identify import identify
from experiments.campaign import read_campaign
from experiments.simulate import simulate

STANDARD = ("geometry", "joint_compliance", "backlash", "gravity", "wrist_coupling_friction")
POSES = 227  # with their returns, three targets: 750 rows


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=3)
    runs = parser.parse_args().runs
    print(f"{'hidden':28}{'rows':>6}{'identify':>12}{'diagnose':>12}  verdict")
    for hidden in ([], ["gear_eccentricity@joint3"]):
        with tempfile.TemporaryDirectory() as folder:
            simulate(Path(folder) / "arm", hidden=hidden, seed=1, poses=POSES, tables=("poses",))
            campaign = read_campaign(Path(folder) / "arm")
        identified, diagnosed = [], []
        for _ in range(runs):
            start = perf_counter()
            model = identify(campaign, {"poses": STANDARD})
            middle = perf_counter()
            found = diagnose(model, campaign).stages["poses"]
            identified.append(middle - start)
            diagnosed.append(perf_counter() - middle)
        rows, names = len(campaign.tables["poses"]), [c["effect"] for c in found.candidates]
        times = f"{np.median(identified):10.2f} s{np.median(diagnosed):10.2f} s"
        print(f"{', '.join(hidden) or 'nothing':28}{rows:6}{times}  {found.verdict} {', '.join(names)}")


if __name__ == "__main__":
    main()
