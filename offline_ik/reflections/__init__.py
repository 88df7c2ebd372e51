"""The sample's position from reflections, and the angles that a detector pixel sees."""
