"""One world for plans, `ik` and the server: obstacles, radii of the links, and distances between them."""
