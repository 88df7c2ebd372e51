"""Draws the shape of a verdict `unknown`, from the JSON of `clampid diagnose`: images/unknown_shape.png.

python docs/make_shape_figure.py diagnosis.json arm.hidden.json
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

IMAGES = Path(__file__).parent / "images"
FOUND, TRUE = "#0b6e99", "#333333"


def main() -> None:
    """Draw the curve with its band, and what the virtual robot hides at joint 3 on top of it."""
    found = json.loads(Path(sys.argv[1]).read_text(encoding="utf-8"))["stages"]["poses"]["shape"]
    amplitude = json.loads(Path(sys.argv[2]).read_text(encoding="utf-8"))[0]["parameters"]["amplitude_rad"]
    (curve,) = found["curves"]
    x, value, low, high = (np.array(curve[key]) for key in ("x", "value", "low", "high"))
    truth = amplitude * np.sin(3 * x)
    truth += np.average(value - truth, weights=1.0 / (high - low) ** 2)  # a constant is the joint's zero
    figure, axes = plt.subplots(figsize=(8, 3.6), layout="constrained")
    axes.fill_between(np.degrees(x), 1e6 * low, 1e6 * high, color=FOUND, alpha=0.25, linewidth=0)
    axes.plot(
        np.degrees(x), 1e6 * value, color=FOUND, linewidth=2, label="as diagnosed, 95 % band over the whole curve"
    )
    axes.plot(np.degrees(x), 1e6 * truth, color=TRUE, linewidth=1.2, linestyle="--", label="as hidden")
    axes.set_xlabel("q3, degrees")
    axes.set_ylabel("angle of joint 3, µrad")
    axes.margins(x=0)
    axes.spines[["top", "right"]].set_visible(False)
    figure.legend(loc="outside upper left", ncols=2, frameon=False)
    figure.savefig(IMAGES / "unknown_shape.png", dpi=150, metadata={"Software": None})


if __name__ == "__main__":
    main()
