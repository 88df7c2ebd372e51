"""Checks of a campaign before any fit: mistakes of units, signs, order and clocks."""
