"""Micro-benchmarks of the service's parts by pytest-benchmark: ``make micro``, never ``make test``."""
