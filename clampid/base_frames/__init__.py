"""Where the robot stands: from circles that joints 1 and 2 trace, or from touched features, sag corrected."""
