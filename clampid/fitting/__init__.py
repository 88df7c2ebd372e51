"""One stage's fit: noise, descent, the flanks on which gears rest, and frictions that only those tell."""
