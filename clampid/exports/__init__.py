"""Tables and files for other programs, each read back, with the error that its form leaves."""
