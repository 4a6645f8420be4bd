"""Fitting a crane's parameters, effects and start to a recording."""
