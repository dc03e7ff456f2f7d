"""Robot descriptions and the project's own models."""
