"""Evidence for and against an effect that is not in the model: scores, flips, likeliest times, shared curves."""
