"""From effects to what they do to an arm: casadi expressions, compiled, with their derivatives."""
