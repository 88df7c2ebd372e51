"""Hides every effect of the virtual worlds at several sizes, and counts what diagnosis calls it.

    python benchmarks/hidden_effects.py OUT [--worlds first,second] [--robots 10] [--seed 1] [--sizes 0.4,0.8,1.6]
        [--families base_tilt,…] [--stages poses,…] [--clean 100] [--poses 200] [--workers 1] [--part 1/1]
        [--kinds single,several,outside,clean] [--draw 0] [--no-best] [--report]

Sizes are the rms of what the start model leaves of the effect, in units of the noise (`hidden_cases.py`). Prints how
often the first name is right, the rate of false alarms where nothing is hidden, how often an effect outside the
library is called unknown, how often the set is exact where two or three are hidden, the held-out error over the best
possible, and the CPU time; and, where both worlds were asked, the two side by side with the gap between them. Writes
OUT/results.jsonl, one line a verdict, from which it goes on where it was stopped; OUT/WORLD/summary.json, table.md and
confusion.svg. `--part 2/3` runs every third trial from the second on. All of one world takes most of a day on one
core; `--robots 2 --sizes 0.8 --clean 10` half an hour. `--draw 3` takes three effects of each stage and one outside the
library of each robot, by its seed: twenty robots of the second world at one size take half an hour.
"""

from __future__ import annotations

import argparse
import json
import os
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from hidden_cases import Case
from hidden_table import by_case, draw, printed, side_by_side, summary
from hidden_trial import clean_trial, hidden_trial
from hidden_worlds import WORLDS

from clampid.effect import STAGES

CLEAN_SEED = 1000  # robots without anything hidden are others than those with something
KINDS = ("single", "several", "outside", "clean")
SEVERAL_SIZE = 0.8


@dataclass(frozen=True)
class Job:
    """One trial: a case at a size, or nothing hidden."""

    world: str
    case: Case | None
    size: float
    seed: int
    poses: int
    best: bool
    stages: tuple[str, ...] = STAGES

    @property
    def key(self) -> str:
        world = "" if self.world == "first" else f"{self.world} "
        what = self.case.label if self.case else "nothing"
        some = f"/{'+'.join(self.stages)}" if self.case is None and set(self.stages) < set(STAGES) else ""
        return f"{world}{what}{some} {self.size:g} {self.seed} {self.poses}"

    def run(self) -> list[dict[str, Any]]:
        world = WORLDS[self.world]
        if self.case is None:
            return clean_trial(world, self.seed, self.poses, self.stages)
        return [hidden_trial(world, self.case, self.size, self.seed, self.poses, self.best)]


def jobs(options: argparse.Namespace) -> Iterator[Job]:
    """All trials that were asked for, seed by seed, so that what is there at any time is a fair sample."""
    sizes = [float(s) for s in options.sizes.split(",")]
    families = options.families.split(",") if options.families else None
    stages, kinds = tuple(options.stages.split(",")), options.kinds.split(",")
    worlds = [WORLDS[name] for name in options.worlds.split(",")]
    wanted = [
        (world.name, case, size)
        for world in worlds
        for kind, cases in world.cases.items()
        for case in cases
        for size in (sizes if kind != "several" else [SEVERAL_SIZE])
        if kind in kinds and case.stage in stages and (families is None or set(case.hidden) & set(families))
    ]
    by_world = {w.name: list(dict.fromkeys(case for name, case, _ in wanted if name == w.name)) for w in worlds}
    clean = options.clean if "clean" in kinds and families is None else 0
    done = 0
    rest = (options.poses, options.best)
    for number in range(options.robots):
        seed = options.seed + number
        mine = {name: drawn(wanted_of, seed, options.draw) for name, wanted_of in by_world.items()}
        yield from (Job(name, case, size, seed, *rest) for name, case, size in wanted if case in mine[name])
        until = clean * (number + 1) // options.robots
        first = CLEAN_SEED + options.seed - 1
        yield from (
            Job(world.name, None, 0.0, first + k, *rest, stages) for k in range(done, until) for world in worlds
        )
        done = until


def drawn(cases: Sequence[Case], seed: int, count: int) -> list[Case]:
    """So many of the single effects of each stage, and one outside the library, by seed; all cases where it is 0."""
    if not count:
        return list(cases)
    rng, out = np.random.default_rng(seed), list[Case]()
    single = [case for case in cases if not case.depends_on and len(case.hidden) == 1]
    for stage in STAGES:
        mine = [case for case in single if case.stage == stage]
        out += [mine[k] for k in rng.choice(len(mine), min(count, len(mine)), replace=False)] if mine else []
    outside = [case for case in cases if case.depends_on]
    return [*out, outside[rng.integers(len(outside))]] if outside else out


def part_of(all_jobs: list[Job], part: str) -> list[Job]:
    """Every n-th trial from the k-th on, of ``k/n``."""
    k, n = (int(number) for number in part.split("/"))
    return all_jobs[k - 1 :: n]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--worlds", default="first", help="first, second, or both as first,second")
    parser.add_argument("--robots", type=int, default=10, help="how many robots, each of its own seed")
    parser.add_argument("--seed", type=int, default=1, help="of the first robot")
    parser.add_argument("--part", default="1/1", help="k/n: every n-th trial from the k-th on")
    parser.add_argument("--sizes", default="0.4,0.8,1.6")
    parser.add_argument("--families", default="", help="only these names of the virtual robot")
    parser.add_argument("--stages", default=",".join(STAGES))
    parser.add_argument("--kinds", default=",".join(KINDS))
    parser.add_argument("--clean", type=int, default=100, help="robots with nothing hidden")
    parser.add_argument("--poses", type=int, default=200)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--draw", type=int, default=0, help="effects of each stage that a robot is tested with; 0: all")
    parser.add_argument("--no-best", dest="best", action="store_false", help="do not fit the true effects")
    parser.add_argument("--report", action="store_true", help="run nothing, report on all that OUT holds")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    file = options.out / "results.jsonl"
    results = [json.loads(line) for line in file.read_text().splitlines()] if file.exists() else []
    wanted = [] if options.report else part_of(list(jobs(options)), options.part)
    keys = {job.key for job in wanted} or {r["key"] for r in results}
    done = {r["key"] for r in results}
    with file.open("a") as out, ProcessPoolExecutor(options.workers) as pool:
        running = {pool.submit(job.run): job for job in wanted if job.key not in done}
        for future in as_completed(running):
            job = running[future]
            try:
                rows = [{**row, "key": job.key, "world": job.world} for row in future.result()]
            except ValueError as error:  # one case that cannot be is no reason to lose the others
                print(f"{job.key}: {error}", flush=True)
                continue
            for row in rows:
                out.write(json.dumps(row) + "\n")
                mark = "" if row["right"] else "  WRONG"
                print(f"{row['key']} {row['stage']}: {row['verdict']} {_names(row)}{mark}", flush=True)
            out.flush()
            results += rows
    counted = [r for r in results if r["key"] in keys]
    by_world = {w: mine for w in WORLDS if (mine := [r for r in counted if r.get("world", "first") == w])}
    for world, rows in by_world.items():
        print(f"\n{world} world")
        report(options.out / world, rows)
    print(f"\n{side_by_side(by_world)}")


def _names(row: dict[str, Any]) -> str:
    return ", ".join([f"{c['effect']}@{'+'.join(c['where'])}" for c in row["candidates"]] or row["depends_on"])


def report(out: Path, results: list[dict[str, Any]]) -> None:
    """Print, write and draw what the results amount to."""
    out.mkdir(exist_ok=True)
    found = summary(results)
    (out / "summary.json").write_text(json.dumps(found, indent=1) + "\n")
    (out / "table.md").write_text(by_case(results) + "\n")
    if results:
        draw(results, out / "confusion.svg")
        draw(results, out / "confusion.png")
    print(by_case(results))
    print(printed(found))


if __name__ == "__main__":
    main()
