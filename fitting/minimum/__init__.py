"""The minimum of the loss: starting values, search and Gauss-Newton steps."""
