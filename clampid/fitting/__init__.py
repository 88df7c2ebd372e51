"""The fit of one stage: noise, least squares, the flanks on which gears rest, and friction that flanks alone show."""
