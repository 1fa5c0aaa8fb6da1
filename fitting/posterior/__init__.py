"""The posterior distribution of the parameters."""
