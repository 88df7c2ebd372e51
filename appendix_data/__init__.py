"""What the sources print, the consistent form, and why. Data only: its one loader is kinematics.description."""
