"""Tables and files for others, each read back, with what its form cannot say in numbers."""
