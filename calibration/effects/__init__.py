"""Sources of error that samples share."""
