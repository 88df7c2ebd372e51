"""Makes the figure of the page on a real robot: ``python docs/make_ur10_figure.py SERIES_C SERIES_D``.

The two folders are public measurements in the campaign format, which are not part of this project.
"""

from __future__ import annotations

import sys
from pathlib import Path

import matplotlib as mpl
import numpy as np

mpl.use("Agg")
import matplotlib.pyplot as plt

from clampid.catalogue import catalogue
from clampid.curves import angle_errors
from clampid.identify import identify
from experiments.campaign import read_campaign

IMAGE = Path(__file__).parent / "images" / "ur10_angle_curves.png"
EFFECTS = ("geometry", "joint_compliance", "joint_angle_curve")
BLUE, GREY = "#0072B2", "#b0b0b0"
COLOURS = ("#222222", "#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00")
STEPS = 720


def aligned(error: np.ndarray, far: np.ndarray, reference: int = 0) -> list[tuple[np.ndarray, int, int]]:
    """Each joint's curve turned, and mirrored where that fits better, onto the reference's: curve, sense, steps."""
    out = []
    base = np.where(far[:, reference], np.nan, error[:, reference])
    for j in range(error.shape[1]):
        own = np.where(far[:, j], np.nan, error[:, j])
        best = (-2.0, own, 1, 0)
        for sense in (1, -1):
            turned = own if sense == 1 else -own[::-1]
            for shift in range(STEPS):
                y = np.roll(turned, shift)
                both = np.isfinite(y) & np.isfinite(base)
                if both.sum() > STEPS // 6:
                    r = float(np.corrcoef(y[both], base[both])[0, 1])
                    best = max(best, (r, y, sense, shift), key=lambda b: b[0])
        out.append(best[1:])
        print(
            f"joint {j + 1}: correlation {best[0]:.2f}, sense {best[2]:+d}, turned by {best[3] * 360 / STEPS:.1f} deg"
        )
    return out


def main(folders: list[str]) -> None:
    """Fit both sessions as one robot and draw its joints' errors, each by itself and all on each other."""
    campaigns = [read_campaign(Path(f)) for f in folders]
    model = identify(campaigns, EFFECTS, holdout=0.05)
    angle = -np.pi + 2 * np.pi * np.arange(STEPS) / STEPS
    q = np.tile(angle[:, None], (1, 6))
    found = angle_errors(model.stages["poses"], catalogue(), model.layout, campaigns[0].robot, q)
    degrees, error, two = np.degrees(angle), 1e6 * found.error, 2e6 * found.std
    figure = plt.figure(figsize=(10, 8.4), layout="constrained")
    panels = figure.subplot_mosaic([[0, 1, 2], [3, 4, 5], ["all"] * 3])
    for j in range(6):
        axes = panels[j]
        far = found.extrapolated[:, j]
        axes.fill_between(degrees, error[:, j] - two[:, j], error[:, j] + two[:, j], color=BLUE, alpha=0.25, lw=0)
        axes.plot(degrees, np.where(far, np.nan, error[:, j]), color=BLUE, lw=1)
        axes.plot(degrees, np.where(far, error[:, j], np.nan), color=GREY, lw=1)
        axes.set(title=f"joint {j + 1}", xlim=(-180, 180), ylim=(-1600, 1600), xticks=range(-180, 181, 90))
        if j % 3 == 0:
            axes.set_ylabel("arm less controller, µrad")
    slow = np.column_stack([f(k * angle) for k in (1, 2) for f in (np.sin, np.cos)] + [np.ones(STEPS)])
    level = error.copy()
    for j in range(6):
        seen = ~found.extrapolated[:, j]
        level[:, j] -= slow @ np.linalg.lstsq(slow[seen], error[seen, j], rcond=None)[0]
    for j, (curve, sense, _) in enumerate(aligned(level, found.extrapolated)):
        label = f"joint {j + 1}{', mirrored' if sense < 0 else ''}"
        panels["all"].plot(degrees, curve, color=COLOURS[j], lw=1, label=label)
    title = "all six, each turned by an angle of its own, without their first two harmonics"
    panels["all"].set(title=title, xlim=(-180, 180), ylabel="µrad", xlabel="joint angle, degrees")
    panels["all"].legend(ncols=6, fontsize=8, loc="upper center")
    IMAGE.parent.mkdir(exist_ok=True)
    figure.savefig(IMAGE, dpi=110)


if __name__ == "__main__":
    main(sys.argv[1:])
