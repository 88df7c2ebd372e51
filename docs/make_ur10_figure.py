"""Makes the figure of the page on a real robot: ``python docs/make_ur10_figure.py SERIES_C SERIES_D``.

The two folders are public measurements in the campaign format, which are not part of this project.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

import matplotlib as mpl
import numpy as np

mpl.use("Agg")
import matplotlib.pyplot as plt

from clampid.catalogue import catalogue
from clampid.identification.identify import identify
from clampid.identification.model_on_campaign import on_campaign
from clampid.models.curves import angle_errors, shared_curve
from clampid.models.model import Model
from clampid.report.angle_curves import points_on
from clampid.report.stage_data import stage_data
from experiments.campaign import Campaign, read_campaign

IMAGE = Path(__file__).parent / "images" / "ur10_angle_curves.png"
EFFECTS = ("geometry", "joint_compliance", "shared_angle_curve")
BLUE, GREY = "#0072B2", "#b0b0b0"
COLOURS = ("#56B4E9", "#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00")
CURVE_POINTS = 720


def draw(model: Model, campaigns: Sequence[Campaign]) -> None:
    """Each joint's error by itself, and the one curve with what the poses of all joints say of it."""
    stage = model.stages["poses"]
    angle = np.linspace(-np.pi, np.pi, CURVE_POINTS + 1)
    found = angle_errors(stage, catalogue(), model.layout, campaigns[0].robot, np.tile(angle[:, None], (1, 6)))
    one = shared_curve(stage, catalogue(), np.linspace(0.0, 2 * np.pi, 2 * CURVE_POINTS + 1))
    if one is None:
        raise SystemExit("no two joints share a curve")
    figure = plt.figure(figsize=(10, 8.4), layout="constrained")
    panels = figure.subplot_mosaic([[0, 1, 2], [3, 4, 5], ["all"] * 3], height_ratios=[1, 1, 1.7])
    degrees, error, two = np.degrees(angle), 1e6 * found.error, 2e6 * found.std
    for j in range(6):
        axes, far = panels[j], found.extrapolated[:, j]
        axes.fill_between(degrees, error[:, j] - two[:, j], error[:, j] + two[:, j], color=BLUE, alpha=0.25, lw=0)
        axes.plot(degrees, np.where(far, np.nan, error[:, j]), color=BLUE, lw=1)
        axes.plot(degrees, np.where(far, error[:, j], np.nan), color=GREY, lw=1)
        axes.set(title=f"joint {j + 1}", xlim=(-180, 180), ylim=(-1600, 1600), xticks=range(-180, 181, 90))
        if j % 3 == 0:
            axes.set_ylabel("arm less controller, µrad")
    axes = panels["all"]
    for session, campaign in enumerate(campaigns):
        for j, on, value in points_on(one, stage_data(on_campaign(model, campaign)).get("poses")):
            label = f"joint {j + 1}{', mirrored' if one.sense[one.joints.index(j)] < 0 else ''}"
            label = label if session == 0 else "_" + label
            axes.plot(np.degrees(on), 1e6 * value, ".", ms=3, color=COLOURS[j], label=label)
    curve, two = 1e6 * one.error, 2e6 * one.std
    axes.fill_between(np.degrees(one.angle), curve - two, curve + two, color="black", alpha=0.25, lw=0)
    axes.plot(np.degrees(one.angle), curve, color="black", lw=1)
    axes.set(title="the one curve", xlim=(0, 360), xticks=range(0, 361, 30), ylabel="µrad")
    axes.set_xlabel("angle on the curve, s q − phase, degrees")
    axes.legend(ncols=6, fontsize=8, loc="upper center", markerscale=3)
    IMAGE.parent.mkdir(exist_ok=True)
    figure.savefig(IMAGE, dpi=110)


def main(folders: list[str]) -> None:
    """Fit both sessions as one robot, but for a fifth of the poses, and draw what its joints are off by."""
    campaigns = [read_campaign(Path(f)) for f in folders]
    draw(identify(campaigns, EFFECTS, holdout=0.2), campaigns)


if __name__ == "__main__":
    main(sys.argv[1:])
