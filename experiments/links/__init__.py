"""Links to robots: one vendor-neutral protocol, and one module for each way of speaking to a controller."""
