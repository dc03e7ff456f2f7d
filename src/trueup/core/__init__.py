"""Vocabulary of the package; numpy only."""
