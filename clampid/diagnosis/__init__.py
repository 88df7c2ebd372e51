"""Diagnosis: where a model fails, and which physical effect is missing."""
