"""Collisions of the arm: shapes, meshes and the world of them, free postures and free paths."""
