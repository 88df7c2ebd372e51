"""What is described around the arm: convention, mount, detector coordinates, frames, limits, and their checks."""
