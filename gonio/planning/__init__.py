"""Where to measure: plans of images by Fisher information, and their check by simulation."""
