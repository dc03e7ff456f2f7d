"""Learned corrections: networks that turn simulated signals into what the robot would have measured."""
