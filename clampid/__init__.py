"""Why the real robot deviates: effects, the chain, fit, diagnosis, comparison, reports, command line."""
