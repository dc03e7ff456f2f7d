"""Robot logs on disk: one folder, read lazily, written so that nothing finished is lost."""
