"""What a fit says of its data and of its model."""
