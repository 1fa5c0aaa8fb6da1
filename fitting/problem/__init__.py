"""What is minimised: residuals, weights, losses and shared errors."""
