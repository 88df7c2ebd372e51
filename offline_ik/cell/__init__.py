"""The cell around the arm: convention, mount, detector coordinates, frames, limits, and their checks."""
