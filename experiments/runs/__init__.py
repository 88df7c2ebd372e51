"""Runs plans on a robot: every step on disk before the next motion, resumable, converted to a campaign at the end."""
