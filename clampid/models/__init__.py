"""Models: the model file, its ranges and correlations, and the arm that it describes."""
