"""What the beamline asks for: detector coordinates and the joint commands that put the detector there."""
