"""The search for what a model lacks: models, moves, one score, one stopping rule, and a verdict that is a function of
the path.
"""
