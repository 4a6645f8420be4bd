"""The search for what a model lacks: screening all effects, fitting the likely ones, weighing them."""
