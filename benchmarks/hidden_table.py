"""The figures of the benchmark of hidden effects: rates with their intervals, and the confusion table."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy import stats

Results = Sequence[Mapping[str, Any]]
LEVEL = 0.95


def clopper_pearson(hits: int, trials: int) -> tuple[float, float]:
    """The exact 95 % interval of a rate (Clopper & Pearson, Biometrika 26, 1934)."""
    tail = (1 - LEVEL) / 2
    low = float(stats.beta.ppf(tail, hits, trials - hits + 1)) if hits else 0.0
    high = float(stats.beta.isf(tail, hits + 1, trials - hits)) if hits < trials else 1.0
    return low, high


def rate(hits: int, trials: int) -> str:
    """A rate with its interval, in per cent."""
    if not trials:
        return "–"
    low, high = clopper_pearson(hits, trials)
    return f"{hits}/{trials} = {100 * hits / trials:.0f} % ({100 * low:.0f} to {100 * high:.0f})"


def wilson(hits: int, trials: int) -> tuple[float, float]:
    """The 95 % score interval of a rate (Wilson, J. Am. Stat. Assoc. 22, 1927)."""
    z = float(stats.norm.isf((1 - LEVEL) / 2))
    p, centre = hits / trials, (hits + z**2 / 2) / (trials + z**2)
    half = z * np.sqrt(p * (1 - p) * trials + z**2 / 4) / (trials + z**2)
    return max(centre - half, 0.0), min(centre + half, 1.0)


def gap(first: tuple[int, int], second: tuple[int, int]) -> tuple[float, float, float]:
    """A rate less another, hits and trials of each, with the 95 % interval of the difference.

    Built from both Wilson intervals (Newcombe, Statistics in Medicine 17, 1998, method 10).
    """
    p, q = first[0] / first[1], second[0] / second[1]
    (pl, pu), (ql, qu) = wilson(*first), wilson(*second)
    return p - q, p - q - float(np.hypot(p - pl, qu - q)), p - q + float(np.hypot(pu - p, q - ql))


def untestable(row: Mapping[str, Any]) -> bool:
    """Whether the effect could not be made as large as asked: absorbed by the start model, or bounded by physics."""
    return any(s < 0.5 * row["size"] for s in row["sizes"])


def summary(results: Results) -> dict[str, Any]:
    """All figures, for people as text and for programs as counts."""
    single = [r for r in results if r["kind"] == "single" and not untestable(r)]
    several = [r for r in results if r["kind"] == "several"]
    clean = [r for r in results if r["kind"] == "clean"]
    outside = [r for r in results if r["kind"] == "outside"]
    out: dict[str, Any] = {"first name right": {}, "unknown recall": {}}
    for size in sorted({r["size"] for r in single}):
        mine = [r for r in single if r["size"] == size]
        out["first name right"][f"{size:g}"] = _count(mine, "right")
    for size in sorted({r["size"] for r in outside}):
        mine = [r for r in outside if r["size"] == size]
        out["unknown recall"][f"{size:g}"] = _count(mine, "right")
    out["false alarms"] = {"hits": sum(not r["right"] for r in clean), "trials": len(clean)}
    out["exact set, one hidden"] = _count(single, "exact")
    for number in (2, 3):
        mine = [r for r in several if len(r["truth"]) == number]
        out[f"exact set, {number} hidden"] = _count(mine, "exact")
        found = {"hits": sum(r["found"] for r in mine), "trials": number * len(mine)}
        out[f"effects found, {number} hidden"] = found
    ratios = [r["after"] / r["best"] for r in (*single, *several) if r.get("best")]
    if ratios:
        shares = np.quantile(ratios, [0.5, 0.9, 1.0])
        out["held-out error over the best possible"] = dict(
            zip(("median", "90 %", "worst"), shares.tolist(), strict=True)
        )
    out["seconds"] = {
        stage: {
            "median": float(np.median([r["seconds"] for r in results if r["stage"] == stage])),
            "rows": float(np.median([r["rows"] for r in results if r["stage"] == stage])),
        }
        for stage in sorted({r["stage"] for r in results})
    }
    return out


def _count(rows: Results, key: str) -> dict[str, int]:
    return {"hits": sum(bool(r[key]) for r in rows), "trials": len(rows)}


def printed(found: Mapping[str, Any]) -> str:
    """The summary as lines."""
    lines = []
    for name, value in found.items():
        if "hits" in value:
            lines.append(f"{name:40} {rate(value['hits'], value['trials'])}")
        elif name == "seconds":
            lines += [f"CPU of {s:34} {v['median']:.2f} s for {v['rows']:.0f} rows" for s, v in value.items()]
        elif name.startswith("held-out"):
            lines.append(f"{name:40} " + ", ".join(f"{k} {v:.3f}" for k, v in value.items()))
        else:
            lines += [f"{f'{name}, {size} sigma':40} {rate(v['hits'], v['trials'])}" for size, v in value.items()]
    return "\n".join(lines)


SEEN = 29.8  # the noncentrality that is found with 90 % power among the named effects, of three parameters


def noncentrality(row: Mapping[str, Any]) -> float:
    """What all numbers of a trial's table say of its effect together: squares in units of the noise."""
    numbers = row["rows"] * (3 if row["stage"] == "poses" else 1)
    return float(numbers * min(row["sizes"]) ** 2)


_FIGURES: Mapping[str, tuple[str, Callable[[Mapping[str, Any]], bool], Callable[[Mapping[str, Any]], bool]]] = {
    "right: first name, or in a set of at most three": ("single", lambda r: True, lambda r: bool(r["right"])),
    "the same where the rows can know (90 % power)": (
        "single",
        lambda r: noncentrality(r) >= SEEN,
        lambda r: bool(r["right"]),
    ),
    "top 1: first of the names said": ("single", lambda r: "top1" in r, lambda r: bool(r["top1"])),
    "unknown, with a right variable": ("outside", lambda r: True, lambda r: bool(r["right"])),
    "the same where the rows can know": (
        "outside",
        lambda r: noncentrality(r) >= SEEN,
        lambda r: bool(r["right"]),
    ),
    "false alarms, verdicts with nothing hidden": ("clean", lambda r: True, lambda r: not r["right"]),
}
SMALLEST = 0.4  # sigma


def side_by_side(worlds: Mapping[str, Results]) -> str:
    """The same figures of each world, all sizes from 0.4 sigma together, with Wilson intervals, and the gap of two."""
    names = list(worlds)
    heads = [f"{name} world" for name in names] + (["gap, points"] if len(names) == 2 else [])
    lines = [f"{'':48}" + "".join(f"{h:32}" for h in heads)]
    for title, (kind, counts, hit) in _FIGURES.items():
        found: list[tuple[int, int]] = []
        for rows in worlds.values():
            mine = [r for r in rows if r["kind"] == kind and (kind == "clean" or _sized(r)) and counts(r)]
            found.append((sum(hit(r) for r in mine), len(mine)))
        cells = [_cell(*f) for f in found]
        if len(names) == 2 and all(n for _, n in found):
            difference, low, high = (100 * v for v in gap(found[0], found[1]))
            cells.append(f"{difference:+.1f} ({low:+.1f} to {high:+.1f})")
        lines.append(f"{title:48}" + "".join(f"{c:32}" for c in cells))
    return "\n".join(lines)


def _sized(row: Mapping[str, Any]) -> bool:
    return row["size"] >= SMALLEST and not untestable(row)


def _cell(hits: int, trials: int) -> str:
    if not trials:
        return "–"
    low, high = wilson(hits, trials)
    return f"{hits}/{trials} {100 * hits / trials:.1f} % ({100 * low:.1f} to {100 * high:.1f})"


def by_case(results: Results) -> str:
    """One line a case and size: how often right, and what was said otherwise, as a table in Markdown."""
    lines = ["| hidden, stage | size | right | otherwise said |", "|---|--:|--:|---|"]
    keys = sorted({(r["kind"], r["case"], r["size"]) for r in results if r["kind"] != "clean"}, reverse=True)
    for kind, case, size in keys:
        mine = [r for r in results if (r["kind"], r["case"], r["size"]) == (kind, case, size)]
        wrong = Counter(_said(r) for r in mine if not r["right"])
        said = "; ".join(f"{text}{f' ({n})' if n > 1 else ''}" for text, n in wrong.most_common())
        held = (
            "" if not any(untestable(r) for r in mine) else f" (reached {np.median([r['sizes'][0] for r in mine]):.2g})"
        )
        lines.append(f"| {case} | {size:g}{held} | {sum(r['right'] for r in mine)}/{len(mine)} | {said} |")
    return "\n".join(lines)


def _said(row: Mapping[str, Any]) -> str:
    names = [c["effect"] + (f" at {' '.join(c['where'])}" if c["where"] else "") for c in row["candidates"][:3]]
    if row["verdict"] == "unknown":
        names.append("on " + " ".join(row["depends_on"][:3]))
    return f"{row['verdict']}: {', '.join(names)}" if names else str(row["verdict"])


def draw(results: Results, path: Path) -> None:
    """The confusion table: what was hidden against the family named first, in shares of a row."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    rows = [r for r in results if r["kind"] in ("single", "clean", "outside")]
    rows = [r for r in rows if r["kind"] != "single" or not untestable(r)]
    truth = [r["case"] for r in rows]
    said = [_first(r) for r in rows]
    cases = sorted(set(truth), key=lambda c: (c.split("/")[1], c.startswith(("outside", "nothing")), c))
    order = {c: k for k, c in enumerate(dict.fromkeys(c.split("/")[0] for c in cases))}
    names = sorted(set(said), key=lambda s: (s in ("unknown", "adequate"), order.get(s, len(order)), s))
    table = np.zeros((len(cases), len(names)))
    for t, s in zip(truth, said, strict=True):
        table[cases.index(t), names.index(s)] += 1
    share = table / table.sum(axis=1, keepdims=True)
    figure, axes = pyplot.subplots(figsize=(0.42 * len(names) + 4.2, 0.3 * len(cases) + 2.6), layout="constrained")
    axes.imshow(share, cmap="Blues", vmin=0.0, vmax=1.0, aspect="auto")
    for i, j in zip(*np.nonzero(table), strict=True):
        axes.text(j, i, f"{table[i, j]:.0f}", ha="center", va="center", color="white" if share[i, j] > 0.5 else "black")
    axes.set_xticks(range(len(names)), [n.replace("_", " ") for n in names], rotation=60, ha="right")
    axes.set_yticks(range(len(cases)), [c.replace("_", " ").replace("/", ", ") for c in cases])
    axes.set_xlabel("named first (number of verdicts)")
    axes.set_ylabel("hidden, stage")
    figure.savefig(path)
    pyplot.close(figure)


def _first(row: Mapping[str, Any]) -> str:
    """The name that counts: the true one where it stands in an admitted set, else the first."""
    if row["kind"] == "single" and row["right"]:
        return str(row["truth"][0]["family"])
    if row["verdict"] in ("unknown", "adequate") or not row["candidates"]:
        return str(row["verdict"])
    return str(row["candidates"][0]["effect"])
