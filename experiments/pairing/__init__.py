"""Pairs two raw logs, an instrument's and a robot's, whose clocks are not synchronised."""

from experiments.pairing.clocks import ClockFit, fit_clocks
from experiments.pairing.geometry import rigid_residuals
from experiments.pairing.pairs import LeftOut, Pair, Pairing, confirmed, pair_logs
from experiments.pairing.stops import Stops, find_stops

__all__ = [
    "ClockFit", "LeftOut", "Pair", "Pairing", "Stops", "confirmed", "find_stops", "fit_clocks", "pair_logs",
    "rigid_residuals",
]  # fmt: skip
