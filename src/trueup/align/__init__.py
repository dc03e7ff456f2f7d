"""Bring command, measurement and simulation onto the same joints and the same time."""
