"""What is wrong with the frames of a session."""
