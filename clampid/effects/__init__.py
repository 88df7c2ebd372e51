"""The physical effects, one file each. What is in this folder is in the catalogue, and is tested."""
