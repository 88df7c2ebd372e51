"""What is measured and how: campaign folders, the experiments, and the virtual robot."""
