"""Measurements: campaign folders, the experiments, and the virtual robot."""
