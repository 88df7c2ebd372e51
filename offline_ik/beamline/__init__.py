"""What a beamline drives the robot with: who holds it, and the line protocol as Tango, EPICS and bluesky see it."""
