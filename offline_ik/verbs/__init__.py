"""The verbs that this layer adds to the command line."""
