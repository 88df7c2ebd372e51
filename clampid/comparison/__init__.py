"""A model against measurements: errors before and after, ISO 9283, and what its compensation does to commands."""
