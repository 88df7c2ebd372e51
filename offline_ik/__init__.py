"""Detector positions for the beamline: detector coordinates, and the joint commands that reach them."""
