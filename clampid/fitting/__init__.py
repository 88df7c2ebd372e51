"""The fit of one stage: noise, least squares, the gear flanks in contact, and dry friction identified by flanks."""
