"""From campaigns to models: stages one after the other or together, and what one stage tells the next."""
