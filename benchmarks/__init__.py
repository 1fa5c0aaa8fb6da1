"""What gonio's speed is measured with; python -m benchmarks runs it."""
