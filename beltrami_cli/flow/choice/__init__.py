"""Parameters that minimise the estimated error of the result."""
