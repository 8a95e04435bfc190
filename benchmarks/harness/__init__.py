"""How benchmarks run: suites, runs, rows, statistics, and the gate."""
