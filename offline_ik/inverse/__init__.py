"""From a pose to joint angles: closed form, Newton's method, postures and branches, and the covariance of an answer."""
