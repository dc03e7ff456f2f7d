"""What was asked of each part of trueup, and what it reaches: `python -m benchmarks.acceptance` measures all of it."""
