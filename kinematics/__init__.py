"""The ideal robot: screws, transmission matrix, gravity loads, DH conversions, URDF."""
