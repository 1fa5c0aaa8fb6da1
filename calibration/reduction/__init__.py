"""Raw frames to BRDF samples."""
