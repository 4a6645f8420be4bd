"""Physical effects by name: one a file, each with its law, parameters, places and hooks."""
