"""Benchmarks: each figure beside its limit, compared within one run."""
