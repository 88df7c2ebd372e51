"""Whether a campaign can be what it says: mistakes of units, signs, order and clocks, found before any fit."""
