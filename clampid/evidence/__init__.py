"""Evidence for effects that are not in the model: score tests, sign flips, times of events, shared curves."""
