"""The identified arm: forward map with all effects, its casadi kernels, and the limits of its identified range."""
