"""How results show themselves in a notebook: short in a line, a summary, a table, a figure.

A result says its :meth:`Shown.title`, its :meth:`Shown.findings` and its :meth:`Shown.records`; the rest follows.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from typing import TYPE_CHECKING, Any

from clampid.display import error_text

if TYPE_CHECKING:
    import pandas as pd

    from clampid.charts import Chart

__all__ = ["Shown"]

SHOWN_ROWS = 20  # of a table in a notebook; to_frame() has all
COLORS = ("blue", "orange", "grey")


class Shown:
    """What a result adds to be read in a notebook; a dataclass that takes it needs ``repr=False``."""

    def title(self) -> str:
        """What it is, in a line."""
        raise NotImplementedError

    def findings(self) -> Sequence[str]:
        """What it says, a sentence or two each."""
        return ()

    def records(self) -> Sequence[Mapping[str, Any]]:
        """Its rows as :meth:`to_frame` has them, SI."""
        raise NotImplementedError

    def errors(self) -> Mapping[str, tuple[str, Mapping[str, float | None]]]:
        """Stage or table → unit (``m`` or ``sigma``) and errors by name, in the order in which they are drawn."""
        return {}

    def __repr__(self) -> str:
        return f"<{type(self).__name__}: {self.title()}>"

    def summary(self) -> str:
        """The result in a few lines of text."""
        lines = [self.title()]
        for name, (unit, errors) in self.errors().items():
            figures = ", ".join(f"{which} {error_text(value, unit)}" for which, value in errors.items())
            lines.append(f"{name}: {figures}")
        return "\n".join([*lines, *self.findings()])

    def to_frame(self) -> pd.DataFrame:
        """The numbers as a table, SI."""
        import pandas as pd

        return pd.DataFrame([dict(record) for record in self.records()])

    def plot(self) -> Chart:
        """Errors as bars, one panel for each stage or table; µm, or multiples of the noise."""
        import numpy as np

        from clampid.charts import Axis, Bars, Chart, Panel

        panels = []
        for title, (unit, values) in self.errors().items():
            factor, symbol = (1e6, "µm") if unit == "m" else (1.0, "σ")
            known = {name: factor * value for name, value in values.items() if value is not None}
            colors = [COLORS[min(k, len(COLORS) - 1)] for k in range(len(known))]
            tips = [f"{name}: {error_text(value / factor, unit)}" for name, value in known.items()]
            names = tuple((float(k), name) for k, name in enumerate(known))
            bars = Bars(np.array(list(known.values())), colors, "", tips)
            panels.append(Panel((bars,), Axis(f"error, rms [{symbol}]", 0.0), Axis(flipped=True, ticks=names), title))
        return Chart(tuple(panels), 80.0 + 110.0 * len(panels), across=1, left=150)

    def _repr_html_(self) -> str:
        """The summary and the first rows of the table, for a notebook."""
        frame = self.to_frame()
        more = "" if len(frame) <= SHOWN_ROWS else f"<p>{len(frame) - SHOWN_ROWS} more rows: to_frame()</p>"
        table = frame.head(SHOWN_ROWS).to_html(index=False, border=0, float_format=lambda v: f"{v:.4g}")
        return f"<pre>{escape(self.summary())}</pre>{table}{more}"
