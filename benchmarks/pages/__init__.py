"""Pages of the docs that are made from stored results: `python -m benchmarks.pages` writes them."""
