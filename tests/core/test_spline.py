"""The spline of effects with a signal for each of several values of a shape parameter."""

from __future__ import annotations

import casadi as ca
import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import CubicSpline

from clampid.algebra import spline


@settings(max_examples=50, deadline=None)
@given(
    steps=st.lists(st.floats(0.2, 3.0), min_size=2, max_size=7),
    share=st.floats(0.0, 1.0),
    seed=st.integers(0, 1000),
)
def test_it_is_the_natural_cubic_spline_with_its_slope(steps: list[float], share: float, seed: int) -> None:
    nodes = np.cumsum([0.0, *steps]) - 2.0
    heights = np.random.default_rng(seed).normal(size=len(nodes))
    x = ca.SX.sym("x")
    y = sum(w * h for w, h in zip(spline(x, nodes), heights, strict=True))
    both = ca.Function("both", [x], [y, ca.gradient(y, x)])
    at = nodes[0] + share * (nodes[-1] - nodes[0])
    expected = CubicSpline(nodes, heights, bc_type="natural")
    np.testing.assert_allclose(np.array(both(at), dtype=float).ravel(), [expected(at), expected(at, 1)], atol=1e-9)


def test_weights_are_one_at_their_own_node_and_add_up_to_one() -> None:
    nodes = [-1.0, 0.5, 0.7, 2.0]
    at_nodes = np.array([[float(ca.DM(w)) for w in spline(ca.DM(x), nodes)] for x in nodes])
    np.testing.assert_allclose(at_nodes, np.eye(4), atol=1e-12)
    between = np.array([float(ca.DM(w)) for w in spline(ca.DM(1.3), nodes)])
    np.testing.assert_allclose(between.sum(), 1.0, atol=1e-12)
