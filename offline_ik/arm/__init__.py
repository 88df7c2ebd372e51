"""The identified arm: forward map with all effects, its casadi kernels, and what lies beyond its identification."""
