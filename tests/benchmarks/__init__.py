"""What the benchmarks measure, they measure right."""
