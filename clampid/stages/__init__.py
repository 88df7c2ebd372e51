"""The stages as the fit sees them: rows of signals, and what the chain predicts for them."""
