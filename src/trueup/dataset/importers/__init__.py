"""Importers: one file per log format."""
