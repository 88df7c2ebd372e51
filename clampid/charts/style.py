"""The style sheet of the figures: colours that the colour-blind can distinguish, for light and for dark pages."""

from __future__ import annotations

__all__ = ["STYLE"]

STYLE = """
:root { --blue: #0072B2; --orange: #D55E00; --green: #00855f; --purple: #b25a92; --yellow: #b97f00; --sky: #2f9bd6;
  --ink: #222; --grey: #767676; --faint: #d0d0d0; --grid: #ececec; --page: #fff;
  --size1: #7ad151; --size2: #22a884; --size3: #2a788e; --size4: #414487; --size5: #440154; }
@media screen and (prefers-color-scheme: dark) {
  :root { --blue: #56B4E9; --orange: #f28a3c; --green: #2fc79a; --purple: #d98cbd; --yellow: #e6b93a; --sky: #8fd0f5;
    --ink: #e8e8e8; --grey: #a2a2a2; --faint: #555; --grid: #333; --page: #161616;
    --size1: #5e62b8; --size2: #3f8fb0; --size3: #2fb58f; --size4: #8bd646; --size5: #fde725; }
}
svg.chart { display: block; width: 100%; max-width: 1180px; height: auto; font: 12.5px Inter, "Helvetica Neue",
  Helvetica, Arial, sans-serif; }
svg.chart text { fill: var(--ink); }
svg.chart .tick { fill: var(--grey); font-size: 11.5px; }
svg.chart .middle { text-anchor: middle; } svg.chart .end { text-anchor: end; }
svg.chart .grid { stroke: var(--grid); fill: none; }
svg.chart .axis { stroke: var(--grey); fill: none; }
svg.chart .l { fill: none; stroke: var(--c); stroke-linejoin: round; }
svg.chart .p { fill: none; stroke: var(--c); stroke-linecap: round; }
svg.chart .f { fill: var(--c); }
svg.chart .o { fill: var(--page); stroke: var(--c); stroke-width: 1.5; }
svg.chart .band { fill: var(--c); fill-opacity: .25; }
svg.chart .halo { paint-order: stroke; stroke: var(--page); stroke-width: 4px; stroke-opacity: .85; }
.blue { --c: var(--blue); } .orange { --c: var(--orange); } .green { --c: var(--green); }
.purple { --c: var(--purple); }
.yellow { --c: var(--yellow); } .sky { --c: var(--sky); } .ink { --c: var(--ink); } .grey { --c: var(--grey); }
.faint { --c: var(--faint); } .size1 { --c: var(--size1); } .size2 { --c: var(--size2); } .size3 { --c: var(--size3); }
.size4 { --c: var(--size4); } .size5 { --c: var(--size5); }
"""
