"""Benchmarks of gonio's speed; python -m benchmarks runs them."""
