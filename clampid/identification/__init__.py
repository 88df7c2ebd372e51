"""From campaigns to models: stages one after the other or together, and the priors from one stage to the next."""
