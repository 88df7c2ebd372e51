"""From reflections to the sample, and from a place to what the detector sees."""
