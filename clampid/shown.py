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
    from plotly.graph_objects import Figure

__all__ = ["Shown"]

SHOWN_ROWS = 20  # of a table in a notebook; to_frame() has all
COLORS = ("#0072B2", "#E69F00", "#999999")  # told apart by the colour-blind (Okabe and Ito)


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
            told = ", ".join(f"{which} {error_text(value, unit)}" for which, value in errors.items())
            lines.append(f"{name}: {told}")
        return "\n".join([*lines, *self.findings()])

    def to_frame(self) -> pd.DataFrame:
        """The numbers as a table, SI."""
        import pandas as pd

        return pd.DataFrame([dict(record) for record in self.records()])

    def plot(self) -> Figure:
        """Errors as bars, one group for each stage or table; µm, or multiples of the noise."""
        from plotly.graph_objects import Bar
        from plotly.subplots import make_subplots

        errors = self.errors()
        figure: Figure = make_subplots(rows=1, cols=max(1, len(errors)), subplot_titles=list(errors))
        for column, (unit, values) in enumerate(errors.values(), 1):
            factor, symbol = (1e6, "µm") if unit == "m" else (1.0, "σ")
            known = {name: factor * value for name, value in values.items() if value is not None}
            colors = [COLORS[min(k, len(COLORS) - 1)] for k in range(len(known))]
            bars = Bar(x=list(known), y=list(known.values()), marker={"color": colors}, showlegend=False)
            figure.add_trace(bars, row=1, col=column)
            figure.update_yaxes(title_text=f"error, rms [{symbol}]", row=1, col=column)
        return figure

    def _repr_html_(self) -> str:
        """The summary and the first rows of the table, for a notebook."""
        frame = self.to_frame()
        more = "" if len(frame) <= SHOWN_ROWS else f"<p>{len(frame) - SHOWN_ROWS} more rows: to_frame()</p>"
        table = frame.head(SHOWN_ROWS).to_html(index=False, border=0, float_format=lambda v: f"{v:.4g}")
        return f"<pre>{escape(self.summary())}</pre>{table}{more}"
