"""Learned compensation of commands: delta actions, their networks, and how they are trained (GapONet, ASAP)."""
