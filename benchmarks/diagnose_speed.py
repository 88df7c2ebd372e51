"""CPU time of a whole diagnosis: of pose tables and of torque logs of several lengths, and what a row costs.

    python benchmarks/diagnose_speed.py [--runs 3] [--poses 60,115,227,450] [--logs]

Poses: the standard set, nothing hidden and an eccentric gear hidden; 227 poses with returns and three targets are 750
rows. `--logs`: free air and wrist, about 13 000 rows, and a half and a quarter of them. CPU time, not wall time, so
that other processes on the machine matter less; the ratio to the shortest table says whether cost is linear in rows.
"""

from __future__ import annotations

import argparse
import os
import tempfile
from dataclasses import replace
from pathlib import Path
from time import process_time
from types import MappingProxyType

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from clampid.diagnosis.diagnose import diagnose
from clampid.effect import Stage
from clampid.identification.identify import identify
from experiments.campaign import Campaign, read_campaign
from experiments.simulate import simulate

STANDARD = ("geometry", "joint_compliance", "backlash", "gravity", "wrist_coupling_friction")


def pose_campaign(poses: int, hidden: list[str]) -> Campaign:
    with tempfile.TemporaryDirectory() as folder:
        simulate(Path(folder) / "arm", hidden=hidden, seed=1, poses=poses, tables=("poses",))
        return read_campaign(Path(folder) / "arm")


def log_campaigns() -> list[Campaign]:
    """A log of free air and wrist, and the first half and quarter of each of its runs."""
    with tempfile.TemporaryDirectory() as folder:
        simulate(Path(folder) / "arm", seed=1, tables=("free_air", "wrist"))
        whole = read_campaign(Path(folder) / "arm")
    out = []
    for share in (0.25, 0.5, 1.0):
        cut = {
            name: table[table.groupby("run").cumcount() < share * table.groupby("run")["run"].transform("size")]
            for name, table in whole.tables.items()
        }
        out.append(replace(whole, tables=MappingProxyType({n: t.reset_index(drop=True) for n, t in cut.items()})))
    return out


def timed(
    campaign: Campaign, stage: Stage, effects: dict[Stage, tuple[str, ...]] | None, runs: int
) -> tuple[float, str]:
    model = identify(campaign, effects)
    seconds, found = [], None
    for _ in range(runs + 1):  # the first one compiles
        start = process_time()
        found = diagnose(model, campaign, stages=[stage]).stages[stage]
        seconds.append(process_time() - start)
    assert found is not None
    return float(np.median(seconds[1:])), f"{found.verdict} {', '.join(c['effect'] for c in found.candidates)}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--poses", default="60,115,227,450")
    parser.add_argument("--logs", action="store_true")
    options = parser.parse_args()
    print(f"{'stage, hidden':32}{'rows':>7}{'CPU':>9}{'a row':>11}{'ratio':>8}{'of rows':>9}  verdict")
    for hidden in ([], ["gear_eccentricity@joint3"]):
        cases = [pose_campaign(int(p), hidden) for p in options.poses.split(",")]
        table("poses, " + (", ".join(hidden) or "nothing"), cases, "poses", {"poses": STANDARD}, options.runs)
    if options.logs:
        table("free_air, nothing", log_campaigns(), "free_air", None, options.runs)


def table(
    name: str, cases: list[Campaign], stage: Stage, effects: dict[Stage, tuple[str, ...]] | None, runs: int
) -> None:
    first: tuple[float, int] | None = None
    for campaign in cases:
        rows = sum(len(t) for t in campaign.tables.values())
        seconds, verdict = timed(campaign, stage, effects, runs)
        first = first or (seconds, rows)
        print(
            f"{name:32}{rows:7}{seconds:7.2f} s{1e3 * seconds / rows:8.2f} ms{seconds / first[0]:8.2f}"
            f"{rows / first[1]:9.2f}  {verdict}",
            flush=True,
        )


if __name__ == "__main__":
    main()
