"""A robot with physics of its own, which measures campaigns and hides effects in them."""
