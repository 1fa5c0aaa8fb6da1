"""Covariance, profile likelihood and intervals at a minimum."""
