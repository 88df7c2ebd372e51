"""Draw images/loop.png from the recorded screens of docs/reference/screens.md: ``python docs/make_gallery.py``."""

from __future__ import annotations

import re
from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")
import matplotlib.pyplot as plt

DOCS = Path(__file__).parent
SCREENS = DOCS / "reference" / "screens.md"
PICTURE = DOCS / "images" / "loop.png"
HEADS = ("nominal robot", "first model", "after diagnosis", "noise floor")
COLORS = ("#9a9a9a", "#56b4e9", "#0072b2", "#222222")
UNITS = {"mm": 1e-3, "µm": 1e-6}
CAMPAIGNS = (
    ("KUKA KR20, simulated, 80 held-out poses", "arm"),
    ("UR10, real, 632 poses in five folds", "ur10_series_d"),
)


def errors(campaign: str) -> list[float]:
    """Nominal, first model, mended model and noise floor of the poses, m, as `clampid auto` printed them."""
    text = SCREENS.read_text(encoding="utf-8")
    screen = re.search(rf"\$ clampid auto {campaign} .*?```", text, re.DOTALL)
    assert screen is not None
    line = next(line for line in screen[0].splitlines() if line.strip().startswith("poses "))
    return [float(number) * UNITS[unit] for number, unit in re.findall(r"([\d.]+) (mm|µm)", line)]


def main() -> None:
    """Draw a row of bars for each campaign, on a logarithmic axis."""
    figure, every = plt.subplots(1, 2, figsize=(9, 2.7), layout="constrained", sharey=True)
    for axes, (title, campaign) in zip(every, CAMPAIGNS, strict=True):
        values = errors(campaign)
        axes.barh(range(4), values, color=COLORS, height=0.65)
        for k, value in enumerate(values):
            text = f"{value * 1e3:.2f} mm" if value >= 1e-3 else f"{value * 1e6:.3g} µm"
            axes.annotate(text, (value, k), (5, 0), textcoords="offset points", va="center", fontsize=9)
        axes.set_xscale("log")
        axes.set_xlim(1e-5, 8e-3)
        axes.set_xticks([1e-5, 1e-4, 1e-3], ["10 µm", "100 µm", "1 mm"])
        axes.set_yticks(range(4), HEADS)
        axes.set_title(title, loc="left", fontsize=10)
        axes.spines[["top", "right"]].set_visible(False)
    every[0].invert_yaxis()  # the two share it
    every[0].set_xlabel("held-out error (rms)")
    every[1].set_xlabel("held-out error (rms)")
    figure.savefig(PICTURE, dpi=140, metadata={"Software": None})


if __name__ == "__main__":
    main()
