"""The beamline's side: who holds the robot, and the line protocol as Tango, EPICS and bluesky devices."""
