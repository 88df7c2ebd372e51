"""One world for plans, `ik` and the server: what stands around an arm, how thick its links are, what touches what."""
