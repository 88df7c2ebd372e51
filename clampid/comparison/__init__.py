"""A model against measurements: errors before and after, ISO 9283, and the change of commands by its compensation."""
