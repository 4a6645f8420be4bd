"""Constitutive laws of the hydraulics, one a file: pure compiled functions of numbers in SI."""
