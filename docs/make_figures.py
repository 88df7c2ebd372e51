"""Makes the pictures of the documentation from a real run: ``make figures``."""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import matplotlib as mpl

mpl.use("Agg")
import matplotlib.pyplot as plt

from clampid.display import error_text
from clampid.loop.demo import demo

IMAGES = Path(__file__).parent / "images"
SEED = 1
NAMES = {"free_air": "free air", "wrist": "wrist", "clamped": "clamped", "poses": "poses"}
BEFORE, AFTER, INK = "#9a9a9a", "#0b6e99", "#333333"


def error_falling(run: Mapping[str, Any], path: Path) -> None:
    """Held-out error of each table over its noise floor, before and after what was found was added."""
    tables = [name for name in NAMES if name in run["after"]["tables"]]
    figure, axes = plt.subplots(figsize=(8, 0.7 * len(tables) + 1.5), layout="constrained")
    for y, name in enumerate(reversed(tables)):
        table, was = run["after"]["tables"][name], run["before"]["tables"][name]
        floor = table["noise_floor"]
        errors = [t["heldout"]["rms"] for t in (was, table)]
        before, after = (error / floor for error in errors)
        if abs(before - after) > 0.2:
            arrow = {"arrowstyle": "-|>", "color": AFTER, "linewidth": 2, "shrinkA": 6, "shrinkB": 5}
            axes.annotate("", (after, y), (before, y), arrowprops=arrow, zorder=1)
        first = y == 0  # one label in the legend is enough
        axes.scatter([before], [y], color=BEFORE, s=70, zorder=2, label="start model" if first else None)
        axes.scatter([after], [y], color=AFTER, s=70, zorder=3, label="with what was named" if first else None)
        texts = [error_text(error, table["unit"]) for error in errors]
        words = " → ".join(dict.fromkeys(texts))
        axes.annotate(words, (max(before, after), y), (10, 0), textcoords="offset points", va="center", color=INK)
    axes.axvline(1.0, color=INK, linewidth=1, linestyle=":", label="noise floor")
    axes.set_yticks(range(len(tables)), [NAMES[name] for name in reversed(tables)])
    axes.set_xlabel("held-out error (rms) over the noise floor")
    axes.set_xlim(0.0, 1.25 * axes.get_xlim()[1])
    axes.set_ylim(-0.6, len(tables) - 0.4)
    axes.spines[["top", "right"]].set_visible(False)
    hidden = ", ".join(f"{item['effect'].replace('_', ' ')} at {item['where']}" for item in run["hidden"])
    axes.set_title(f"Hidden in the virtual robot: {hidden}", loc="left", fontsize=11)
    figure.legend(loc="outside lower center", ncols=3, frameon=False)
    figure.savefig(path, dpi=150, metadata={"Software": None})
    plt.close(figure)


def main() -> None:
    """Run the demo in a folder of its own and draw it."""
    seed = int(sys.argv[1]) if len(sys.argv) > 1 else SEED
    IMAGES.mkdir(exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        run = demo(folder, seed).to_json()
    error_falling(run, IMAGES / "error_falling.png")


if __name__ == "__main__":
    main()
