"""Tests of the proofs that there is no path."""
