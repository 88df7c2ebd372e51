"""What the arm may touch: shapes, meshes and the world of them, free postures and free paths."""
